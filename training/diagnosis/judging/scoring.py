"""Whether the verdict of one record is right."""

from __future__ import annotations

from collections.abc import Iterator

from training.diagnosis.judging.record import NEAR, Record

STRONG_SIZE = 0.5  # half of "plain to see"
STRONG_P = 0.003  # beyond doubt: five tests of 2,000 draws together cannot give less than 0.0025, fewer give less
STRONG_NATS = 15.0  # the design's definition, here of the CRPS on a fresh recording
MM = 1000.0  # per metre
LEAST_SHARE = 0.1  # a wrong cause with a smaller share does little harm
BELIEVED, PARTLY = 0.5, 0.3  # probability and share from which a wrong name of an unmodelled fault misleads
# Changes of the grammar of faults whose constant part is an effect of the catalogue. It cannot be taken out of them, as
# offset, scale and drift are of a bias, so that the name of the effect is in part right.
PARTS = {"hold": "stale_repeat", "loss": "dropped_reading", "steps": "quantisation"}


def true_ids(record: Record) -> set[str]:
    """Return all ids that name a true cause."""
    return {name for cause in record["causes"] for name in cause["accepted"]}


def is_strong(record: Record) -> bool:
    """Return whether every cause is of half the plain size and the test leaves no doubt."""
    large = all(cause["size"] >= STRONG_SIZE for cause in record["causes"])
    return large and record["verdict"]["p_value"] < STRONG_P


def is_apart(record: Record) -> bool:
    """Return whether fresh readings of the two sonars differ by 15 nats, without any law of a sonar."""
    return separation(record) >= STRONG_NATS


def separation(record: Record) -> float:
    """Return how far apart fresh readings of the two sonars are, nats.

    With z the CRPS of the simulation's own readings minus that of a second recording, in standard errors over visits,
    z^2 / 2 is the gain in log-likelihood of a difference (Wilks 1938).
    """
    scores = record["scores"]
    z = (scores["before"] - scores["again"]) / scores["gap_error"] if scores["gap_error"] > 0 else 0.0
    return float(0.5 * max(z, 0.0) ** 2)


def stated(record: Record) -> list[tuple[str, float]]:
    """Return every named effect with its probability: causes and their alternatives."""
    return [pair for cause in record["verdict"]["causes"] for pair in _place(cause)]


def _place(cause: Record) -> list[tuple[str, float]]:
    others = [(each["effect"], each["probability"]) for each in cause["alternatives"]]
    return [(cause["effect"], cause["probability"]), *others]


def leads(record: Record) -> bool:
    """Return whether the most probable effect is a true cause."""
    named = stated(record)
    return bool(named) and max(named, key=lambda pair: pair[1])[0] in true_ids(record)


def matches(record: Record) -> list[list[Record]]:
    """Return for each named cause the true causes that it stands for; a second name of a true cause stands for none.

    A true cause belongs where it is named itself rather than as an alternative, and there where it is most probable.
    """
    causes = record["verdict"]["causes"]
    places: list[list[Record]] = [[] for _ in causes]
    for true in record["causes"]:
        own = [[p for name, p in _place(cause) if name in true["accepted"]] for cause in causes]
        rank = [(cause["effect"] in true["accepted"], sum(p)) for cause, p in zip(causes, own, strict=True)]
        if any(own):
            places[rank.index(max(rank))].append(true)
    return places


def wrong_causes(record: Record) -> Iterator[Record]:
    """Yield the causes that name no true cause, or one that stands in another place."""
    for cause, trues in zip(record["verdict"]["causes"], matches(record), strict=True):
        if not any(cause["effect"] in true["accepted"] for true in trues):
            yield cause


def no_wrong_share(record: Record) -> bool:
    """Return whether no wrong cause holds more than a tenth of the misfit."""
    return all((cause["share"] or 0.0) <= LEAST_SHARE for cause in wrong_causes(record))


def names_all(record: Record) -> bool:
    """Return whether every true cause is named by a cause of its own."""
    named = [cause["effect"] for cause in record["verdict"]["causes"]]
    sets = [[name for name in named if name in cause["accepted"]] for cause in record["causes"]]
    return all(sets) and len({name for names in sets for name in names}) >= len(sets)


def parts_of_fault(record: Record) -> set[str | None]:
    """Return the effects that are a part of an unmodelled fault; None for changes without such a part."""
    return {PARTS.get(change.split(" ")[0]) for change in record["fault"].split("; ")}


def misled(record: Record) -> bool:
    """Return whether a wrong cause, which is no part of the fault, is believed and holds a large share."""
    wrong = (cause for cause in wrong_causes(record) if cause["effect"] not in parts_of_fault(record))
    return any(cause["probability"] >= BELIEVED and (cause["share"] or 0.0) >= PARTLY for cause in wrong)


def aspect_right(record: Record) -> bool:
    """Return whether the first located aspect is one in which the cause shows."""
    where, true = record["verdict"]["where"], {a for cause in record["causes"] for a in cause["aspects"]}
    return bool(where) and where[0]["aspect"] in true


def region_overlap(record: Record) -> float:
    """Return the overlap of the first located region of conditions with a right aspect; 0 where there is none."""
    true = {aspect for cause in record["causes"] for aspect in cause["aspects"]}
    pairs = zip(record["verdict"]["where"], record["overlap"], strict=True)
    return next((iou for place, iou in pairs if place["aspect"] in true and iou is not None), 0.0)


def covered(record: Record) -> Iterator[bool]:
    """Yield, for each true cause that was named by its id, whether the interval holds the true parameter."""
    for cause in record["causes"]:
        interval = record["intervals"].get(cause["effect"], {}).get(cause["parameter"])
        if interval is not None and cause["value"] is not None:
            yield bool(interval[1] <= cause["value"] <= interval[2])


def statements(record: Record) -> Iterator[tuple[float, bool]]:
    """Yield stated probabilities and whether each is true.

    Ids that name the same true cause in the place of one cause are one statement, with the sum of their probabilities.
    """
    for cause, trues in zip(record["verdict"]["causes"], matches(record), strict=True):
        named = _place(cause)
        for true in trues:
            yield min(sum(p for name, p in named if name in true["accepted"]), 1.0), True
            named = [(name, p) for name, p in named if name not in true["accepted"]]
        yield from ((p, False) for _, p in named)


def scores_of(record: Record, near: bool = False) -> Record | None:
    """Return the scores on fresh recordings, or those within the tolerance of credence; None where there are none."""
    scores: Record | None = record["scores"]
    return scores.get(NEAR) if near and scores is not None else scores


def gap_closed(record: Record, model: str = "corrected", near: bool = False) -> float | None:
    """Return the share of the CRPS between simulation and oracle that a model gains on a fresh recording.

    None where simulation and oracle differ by less than two standard errors, so that there is no gap to close.
    """
    scores = scores_of(record, near)
    if scores is None:
        return None
    gap = scores["before"] - scores["again"]
    return float((scores["before"] - scores[model]) / gap) if gap > 2.0 * scores["gap_error"] else None


def gap_unseen(record: Record) -> float | None:
    """Return the gap closed on unseen visits of the recording, with its own repeatability as the oracle.

    None where there is no gap to close, as in `gap_closed`: the fresh recording, which has about as many pings of the
    same two sonars, tells the standard error.
    """
    held, scores = record["verdict"]["held_out"], record["scores"]
    if scores is None:
        return None
    before, after = held["before"]["crps_mm"], held["after"]["crps_mm"]
    gap = before - held["repeatability_mm"]
    return float((before - after) / gap) if gap > 2.0 * MM * scores["gap_error"] else None


def made_worse(record: Record, model: str = "corrected", near: bool = False) -> bool | None:
    """Return whether a model is worse than the simulation on fresh readings, beyond two standard errors."""
    scores = scores_of(record, near)
    if scores is None:
        return None
    return bool(scores[model] - scores["before"] > 2.0 * scores[f"{model}_error"])
