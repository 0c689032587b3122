"""Schemas of model.json, one per kind of model, and of the description of a learned credence."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from annotated_types import MaxLen, MinLen
from pydantic import Field, model_validator

from acquisition.io.schema import Schema
from acquisition.limits import Limit, PositiveMetres, Share

Resolution = Annotated[float, Limit(1e-6, 1.0, "m")]
Width = Annotated[int, Limit(1, 65_536)]
Sizes = Annotated[list[Width], MinLen(2), MaxLen(64)]
Parameters = dict[str, float]
Numbers = list[float]
Format = Literal[1]


class Inputs(Schema):
    """Inputs of a network; see `noise.learned.inputs.Inputs`."""

    names: Annotated[list[str], MinLen(1), MaxLen(256)]
    low: Numbers
    high: Numbers
    folded: bool
    tied: bool
    open_end: bool
    uncompensated: bool = False
    fixed: Parameters = Field(default_factory=dict)
    averaged: Annotated[list[str], MaxLen(256)] = Field(default_factory=list)

    @model_validator(mode="after")
    def _fits(self) -> Inputs:
        if not len(self.names) == len(self.low) == len(self.high) == len(set(self.names)):
            raise ValueError("names, low and high must have equal numbers, and each name once")
        if self.names[0] != "distance" or self.low[0] < 0.0:
            raise ValueError("the first name must be distance, from 0 m or more")
        if any(low > high for low, high in zip(self.low, self.high, strict=True)):
            raise ValueError("low must not exceed high")
        return self


class Head(Schema):
    """Head of a network; see `noise.learned.mixture.Head`."""

    near: Annotated[int, Limit(1, 1024)]
    fixed: Annotated[int, Limit(0, 1024)]
    resolution: Resolution
    max_range: PositiveMetres
    no_answer: Annotated[float, Limit(0.0, 1.0, open_high=True)] = 0.0
    anchored: Annotated[int, Limit(0, 1024)] = 0
    fails: bool = False


class Persistence(Schema):
    """The persisting part of the spread; see `noise.learned.persistence.Persistence`."""

    detection: Share
    range: Share
    lasting: Share = 0.0
    length_m: PositiveMetres = 1.0


class Base(Schema):
    """The perceptron below a hybrid."""

    sizes: Sizes
    head: Head


class Standard(Schema):
    """Standardised inputs of a smooth term."""

    names: list[str]
    middle: Numbers
    scale: Numbers
    low: Numbers
    high: Numbers


class Term(Schema):
    """A smooth term; see `noise.fitting.smooth.Smooth`."""

    term: str
    inputs: Standard
    centres: list[Numbers]
    alpha: dict[str, Any]
    level_centres: Numbers
    beta: dict[str, Any]
    tails_m: Annotated[Numbers, MinLen(2), MaxLen(2)]
    placement_m: float
    level_sd_db: float
    jitter: Annotated[Numbers, MinLen(2), MaxLen(2)]


class Kind(Schema):
    """What every model.json holds; the models inside another have no format of their own."""

    format: Format = 1


class Registered(Kind):
    """A model with a register."""

    resolution: Resolution
    max_range: PositiveMetres


class Ideal(Registered):
    """See `noise.model.IdealModel`."""

    kind: Literal["ideal"]


class Gaussian(Registered):
    """See `noise.model.GaussianModel`."""

    kind: Literal["gaussian"]
    sigma: float
    sigma_per_metre: float
    miss: float


class Beam(Registered):
    """See `noise.beam.BeamModel`."""

    kind: Literal["beam"]
    hit: float
    short: float
    silent: float
    random: float
    sigma: float
    short_rate: float


class Physical(Registered):
    """See `noise.physical.PhysicalModel`."""

    kind: Literal["physical"]
    effects: dict[str, Parameters]


class Effects(Schema):
    """Effects of the catalogue and smooth terms."""

    effects: dict[str, Parameters]
    terms: list[Term]


class Empirical(Registered, Effects):
    """See `noise.fitting.empirical.EmpiricalModel`."""

    kind: Literal["empirical"]


class Trees(Schema):
    """See `noise.discrepancy.baseline.trees.Trees`."""

    root: Annotated[list[int], MinLen(1)]
    feature: list[int]
    threshold: Numbers
    left: list[int]
    right: list[int]


class Leaves(Schema):
    """See `noise.discrepancy.baseline.similarity.Leaves`."""

    names: Annotated[list[str], MinLen(1)]
    times: tuple[float, float]
    typical: Numbers
    trees: Trees


class Similar(Leaves):
    """See `noise.discrepancy.baseline.similarity.Similarity`."""

    leaf: Annotated[list[list[int]], MinLen(1)]


class Forest(Registered, Similar):
    """See `noise.discrepancy.baseline.forest.AnalogueForest`."""

    kind: Literal["forest"]
    error: Annotated[list[float | None], MinLen(1)]


class Table(Registered):
    """See `noise.table.TableModel`."""

    kind: Literal["table"]
    distances: Annotated[Numbers, MinLen(1)]
    means: Annotated[Numbers, MinLen(1)]
    sigmas: Annotated[Numbers, MinLen(1)]
    max_incidence: float


class Network(Kind):
    """A network with its weights in another file."""

    sizes: Sizes
    inputs: Inputs
    head: Head
    persistence: Persistence | None = None
    about: dict[str, Any] = Field(default_factory=dict)


class Mlp(Network):
    """See `noise.learned.networks.MlpModel`."""

    kind: Literal["mlp"]


class Lstm(Network):
    """See `noise.learned.recurrent.LstmModel`."""

    kind: Literal["lstm"]
    hidden: Width
    base: Base | None = None


class Faulty(Kind):
    """See `noise.faults.Faulty`."""

    kind: Literal["faulty"]
    model: Model
    faults: list[dict[str, float | str]]


class Composed(Kind):
    """See `noise.composed.ComposedModel`."""

    kind: Literal["composed"]
    model: Model
    before: Effects
    after: Effects


class Boosted(Leaves):
    """See `noise.discrepancy.baseline.adjusted.Boosted`."""

    value: Numbers


class Outliers(Schema):
    """See `noise.discrepancy.baseline.adjusted.Outliers`."""

    form: Literal["range", "offset", "ratio"]
    value: Numbers


class Adjusted(Kind):
    """See `noise.discrepancy.baseline.adjusted.Adjusted`."""

    kind: Literal["adjusted"]
    model: Model
    parts: dict[Literal["shift", "spread", "lost", "gained", "early", "late"], Boosted]
    outliers: dict[Literal["early", "late"], Outliers]


class Replay(Kind):
    """See `noise.replay.Replay`."""

    kind: Literal["replay"]
    other: Model
    step: Resolution
    resolution: Resolution


class Transport(Kind):
    """See `noise.discrepancy.baseline.transport.Transport`."""

    kind: Literal["transport"]
    own: Model
    model: Model


Model = Annotated[
    Ideal
    | Gaussian
    | Beam
    | Physical
    | Empirical
    | Forest
    | Table
    | Mlp
    | Lstm
    | Faulty
    | Composed
    | Replay
    | Transport
    | Adjusted,
    Field(discriminator="kind"),
]
Faulty.model_rebuild()
Composed.model_rebuild()
Replay.model_rebuild()
Transport.model_rebuild()
Adjusted.model_rebuild()


class Credence(Schema):
    """See `noise.learned.recent.RecentCredence`."""

    format: Format
    depth: Annotated[int, Limit(1, 1024)]
    sizes: Sizes
    about: dict[str, Any] = Field(default_factory=dict)
