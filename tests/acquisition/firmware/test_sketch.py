"""The sketch's protocol, framing, timing and errors, on the host; `mutants` runs these tests on changed sketches."""

import os
import re
import shutil
from pathlib import Path

import pytest

from tests.acquisition.firmware.host import (
    DATA_NACK,
    ECHO,
    LIBRARY,
    SHORT,
    SKETCH,
    STUCK,
    TRIGGER,
    Board,
    compile_sketch,
    framed,
    unframed,
)
from tests.acquisition.firmware.mutants import mutants, survivors

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="no g++: apt install g++")
D = f"D {TRIGGER:X} {ECHO:X} "
MIN_KILLED = 0.9


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    if LIBRARY in os.environ:
        return Path(os.environ[LIBRARY])
    path = tmp_path_factory.mktemp("sketch") / "sketch.so"
    assert compile_sketch(SKETCH.read_text(), path, "-Wall", "-Wextra", "-Werror", "-Wno-unused-function")
    return path


@pytest.fixture
def board(library, tmp_path):
    return Board(library, tmp_path)


def test_it_greets_with_its_protocol_and_sets_up_its_lines(board):
    assert unframed(board.greeting) == "-- B 01"
    assert board.lib.host_baud() == 115_200
    assert [board.lib.host_wire(k) for k in range(4)] == [1, 100_000, 25_000, 1]  # begun, Hz, us, reset after a timeout
    board.lib.host_idle_loop()
    assert board.take() == b""


def test_it_states_name_and_version(board):
    assert board.ask("07 V") == "07 K SONARBRIDGE 01"
    assert board.ask("08 V 1") == "08 E 20"


def test_each_sequence_number_is_repeated(board):
    for number in range(256):
        assert board.ask(f"{number:02X} V") == f"{number:02X} K SONARBRIDGE 01"


@pytest.mark.parametrize("command", ["X", "v", "Q 1", "\x00"])
def test_unknown_commands_are_named(board, command):
    assert board.ask(f"01 {command}".rstrip("\x00") if command != "\x00" else "01 0") == "01 E 22"


GOOD = framed("01 V")
UNFRAMED = [b">01 V*0000\n", b"\xff\x00\n", b">\n", b">01 V\n", b"A" * 300 + b"\n", b"*\n", b">*FFFF\n"]
OTHER_FRAMES = [b"<" + GOOD[1:], GOOD[1:], GOOD[:-1] + b"0\n", GOOD[:-2] + b"\n"]
BAD_LINES = [*UNFRAMED, *OTHER_FRAMES, *map(framed, ("01_V", "1 V", "001 V", "01"))]


@pytest.mark.parametrize("line", BAD_LINES)
def test_a_corrupted_line_is_answered_as_such_and_has_no_later_effect(board, line):
    assert unframed(board.feed(line)) == "-- E 21"
    assert board.ask("01 V") == "01 K SONARBRIDGE 01"


def test_empty_lines_are_ignored_and_bytes_may_come_apart(board):
    assert board.feed(b"\n\n\n") == b""
    line = framed("0A V")
    assert b"".join(board.feed(bytes([byte])) for byte in line[:-1]) == b""
    assert unframed(board.feed(line[-1:])) == "0A K SONARBRIDGE 01"
    both = board.feed(framed("01 V") + framed("02 V")).splitlines(keepends=True)
    assert [unframed(each) for each in both] == ["01 K SONARBRIDGE 01", "02 K SONARBRIDGE 01"]


def test_a_line_may_be_eighty_bytes_long_and_no_longer(board):
    def line(length):
        return framed("01 V" + " " * (length - len(framed("01 V")) + 1))

    assert len(line(80)) == 81  # with its terminator
    assert unframed(board.feed(line(80))) == "01 E 20"  # refused, since V takes no arguments, but not corrupted
    assert unframed(board.feed(line(81))) == "-- E 21"
    assert unframed(board.feed(b"x" * 80 + b"\n")) == "-- E 21"
    assert board.ask("01 V") == "01 K SONARBRIDGE 01"
    assert unframed(board.feed(b"x" * 90 + framed("01 V"))) == "-- E 21"


def test_a_write_is_one_transaction(board):
    board.lib.host_device(0x70)
    assert board.ask("01 W 70 00 51") == "01 K"
    assert board.ask("02 W 70 02 8C FF") == "02 K"
    assert board.writes() == [(0x70, [0x00, 0x51]), (0x70, [0x02, 0x8C, 0xFF])]
    sixteen = list(range(1, 17))
    assert board.ask("03 W 70 " + " ".join(f"{k:02X}" for k in sixteen)) == "03 K"
    assert board.writes() == [(0x70, sixteen)]
    board.lib.host_device(0x7F)
    assert board.ask("04 W 7F 00") == "04 K"
    assert board.ask("05 W 0 1") == "05 E 02"


REFUSED = """W|W 70|W 80 1|W 70 100|W 70 1 G|W 70{}
R|R 70|R 70 0|R 70 00 25|R 70 0 0|R 80 0 1|R 70 100 1|R 70 0 1 1
D|D 9|D 9 8|D 1 8 1000|D 9 1 1000|D 14 8 1000|D 9 14 1000|D 15 8 1000|D 9 9 1000|D 46 8 1000|D 9 46 1000
D 9 8 7A121|D 9 8 100 1|D 100 8 1|D 9 100 1
P|P 9|P 1 1000|P 14 1000|P 9 7A121|P 9 1 1|P 100 1|P 46 1""".format(" 00" * 17)


@pytest.mark.parametrize("request_", re.split(r"[|\n]", REFUSED))
def test_invalid_requests_are_refused_without_effect(board, request_):
    board.lib.host_device(0x70)
    assert board.ask(f"01 {request_}") == "01 E 20"
    assert board.writes() == []
    assert board.lib.host_pin_mode(9) == -1


def test_reads_of_any_length_continue_where_the_last_part_ended(board):
    board.lib.host_device(0x70)
    registers = [(0x70 + 3 * k) % 256 for k in range(256)]
    for first, count in ((0, 1), (2, 34), (0, 36), (0, 32), (1, 33), (0xFF, 1)):
        expected = "".join(f"{value:02X}" for value in registers[first : first + count])
        assert board.ask(f"01 R 70 {first:X} {count:X}") == f"01 K {expected}"
        parts = [(0x70, [first + k]) for k in range(0, count, 32)]
        assert board.writes() == parts
    board.lib.host_device(0x7F)
    assert board.ask("02 R 7F FF 1") == f"02 K {board.lib.host_register(0x7F, 0xFF):02X}"


def test_errors_of_the_bus_are_passed_on_and_do_not_last(board):
    assert board.ask("01 R 70 0 1") == "01 E 02"
    board.lib.host_device(0x70)
    for fault, written, read in ((DATA_NACK, "03", "03"), (STUCK, "05", "05")):
        board.lib.host_fault(fault)
        assert board.ask("02 W 70 0 51") == f"02 E {written}"
        assert board.ask("03 R 70 0 1") == f"03 E {read}"
        board.lib.host_fault(0)
        assert board.ask("04 R 70 0 1") == "04 K 70"
    board.lib.host_fault(SHORT)
    board.lib.host_stuck_later()  # the flag of an earlier timeout
    assert board.ask("05 R 70 0 2") == "05 E 06"


@pytest.mark.parametrize("width", [100, 580, 5800, 38_000, 300_000])
@pytest.mark.parametrize("begin", [0, 2**32 - 700])  # of micros(), which starts again after 71 minutes
def test_the_duration_of_an_echo_is_measured(board, width, begin):
    board.lib.host_set_time(begin)
    board.lib.host_set_echo(TRIGGER, ECHO, 0, 450, width)
    answer = board.ask(f"01 {D}61A80")
    assert answer.startswith("01 K ")
    assert len(answer) == 11
    assert int(answer[5:], 16) == pytest.approx(width, abs=12)
    assert board.lib.host_trigger_low() >= 2
    assert 10 <= board.lib.host_trigger_high() <= 20
    assert board.lib.host_pin_mode(TRIGGER) == 1
    assert board.lib.host_pin_mode(ECHO) == 0


def test_failures_of_an_echo_line_are_told_apart(board):
    board.lib.host_set_echo(TRIGGER, ECHO, 1, 450, 580)
    assert board.ask(f"01 {D}61A80") == "01 E 10"
    assert board.lib.host_pin_mode(TRIGGER) == -1
    board.lib.host_set_echo(TRIGGER, ECHO, 0, 30_000, 580)
    begin = board.lib.host_time()
    assert board.ask(f"02 {D}61A80") == "02 E 11"
    assert board.lib.host_time() - begin == pytest.approx(20_000, abs=100)
    board.lib.host_set_echo(TRIGGER, ECHO, 0, 19_900, 580)
    assert board.ask(f"03 {D}61A80").startswith("03 K ")
    board.lib.host_set_echo(TRIGGER, ECHO, 0, 450, 5_000)
    begin = board.lib.host_time()
    assert board.ask(f"04 {D}3E8") == "04 E 12"
    assert board.lib.host_time() - begin == pytest.approx(1_450, abs=100)


@pytest.mark.parametrize("phase", [0, 500, 3_000, 40_000])
def test_the_next_whole_pulse_of_a_line_is_measured(board, phase):
    board.lib.host_set_pulses(7, 49_000, 1_470)  # an LV-MaxSonar before a target at 10 in
    board.lib.host_set_time(49_000 + phase)
    assert int(board.ask("01 P 7 186A0")[5:], 16) == pytest.approx(1_470, abs=12)
    assert board.lib.host_pin_mode(7) == 0


def test_a_line_without_pulses_is_an_error(board):
    for high, error in ((0, "11"), (49_000, "12")):
        board.lib.host_set_pulses(7, 49_000, high)
        begin = board.lib.host_time()
        assert board.ask("01 P 7 2710") == f"01 E {error}"
        assert board.lib.host_time() - begin == pytest.approx(10_000, abs=100)
    board.lib.host_set_pulses(7, 40_000, 20_000)
    board.lib.host_set_time(35_000)
    assert board.ask("02 P 7 1770") == "02 E 12"


def test_pins_up_to_the_last_and_from_the_third_are_usable(board):
    for trigger, echo in ((2, 69), (69, 2)):
        board.lib.host_set_echo(trigger, echo, 0, 450, 580)
        assert board.ask(f"01 D {trigger:X} {echo:X} 7A120").startswith("01 K ")


@pytest.mark.slow
def test_nine_in_ten_changes_of_the_sketch_are_noticed(tmp_path):
    every = mutants(SKETCH.read_text())
    alive, invalid = survivors(every, tmp_path)
    n = len(every) - len(invalid)
    print(f"{n - len(alive)} of {n} mutants killed, {len(invalid)} do not compile; alive:")
    print("\n".join(map(str, alive)))
    assert n > 100
    assert len(alive) <= (1.0 - MIN_KILLED) * n
