"""The sonar server: readings, memory of each client, and clients that misbehave."""

import asyncio
import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import DeviceError, GarbledError, Ping, SettingError, UnpluggedError
from noise import GaussianModel, load_model, simulate
from sonar_gym.bridges.server import protocol
from sonar_gym.bridges.server.client import SonarClient, simulator_at
from sonar_gym.bridges.server.sensors import Sensors
from sonar_gym.bridges.server.server import ServerSettings, SonarServer, answer
from training.diagnosis.diagnose import simulator_of

CLIENTS = Path(__file__).parents[3] / "examples" / "clients"
NOISY = GaussianModel(0.05, miss=0.2)


class Running:
    """A server in a thread."""

    def __init__(self, model, **settings):
        self.server = SonarServer(model, ServerSettings(port=0, **settings))
        ready, self._loop = threading.Event(), asyncio.new_event_loop()

        def work():
            self._task = self._loop.create_task(self.server.run(ready.set))
            try:
                self._loop.run_until_complete(self._task)
            except asyncio.CancelledError:
                self._loop.run_until_complete(self._loop.shutdown_asyncgens())
            finally:
                for task in asyncio.all_tasks(self._loop):
                    task.cancel()
                self._loop.run_until_complete(asyncio.sleep(0.05))
                self._loop.close()

        self._thread = threading.Thread(target=work)
        self._thread.start()
        assert ready.wait(60)

    def __enter__(self):
        return self.server

    def __exit__(self, *_):
        self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(20)


@pytest.fixture(scope="module")
def noisy():
    with Running(NOISY, patience_s=1.0, max_clients=4) as server:
        yield server


def raw(server):
    connection = socket.create_connection(server.address, 10)
    connection.settimeout(10)
    return connection


def pings(n, sensors=8):
    k = np.arange(n)
    return Ping.of(0.5 + 0.1 * (k % 20), 0.1, 0.05, 0.8, time=0.1 * k, run=k % sensors)


def test_no_pings_have_no_readings(noisy):
    with SonarClient(*noisy.address) as client:
        reading, credence = client.ask(pings(3)[:0])
    assert (len(reading), credence.shape) == (0, (0,))


def test_readings_are_those_of_the_model_with_their_credence(noisy):
    ping = pings(3000)
    with SonarClient(*noisy.address) as client:
        reading, credence = client.ask(ping)
    missed = 1.0 - reading.echo.mean()
    assert missed == pytest.approx(0.2, abs=0.04)
    error = (reading.range - ping.distance)[reading.echo]
    assert error.std() == pytest.approx(np.mean(0.05 + 0.005 * ping.distance), rel=0.1)
    assert np.all(credence[~reading.echo] == 0.0)
    right = np.abs(error) <= 0.1 * ping.distance[reading.echo]
    assert right.mean() == pytest.approx(credence[reading.echo].mean(), abs=0.05)


def test_a_seed_repeats_the_readings_and_clients_do_not_disturb_each_other(noisy):
    with SonarClient(*noisy.address) as one, SonarClient(*noisy.address) as two:
        one.seed(5)
        two.seed(5)
        first, _ = one.ask(pings(20))
        two.ask(pings(7))
        again, _ = one.ask(pings(20))
        one.seed(5)
        repeated, _ = one.ask(pings(20))
    np.testing.assert_array_equal(first.range, repeated.range)
    assert not np.array_equal(first.range, again.range)


@pytest.mark.parametrize("name", ["srf08-mlp", "srf08-lstm", "srf08-hybrid"])
def test_models_with_memory_are_asked_as_in_a_simulation(name):
    ping, model = pings(200, sensors=4), load_model(name)
    reading, _ = Sensors(model, 20.0, 3).answer(ping)
    expected = simulate(model, ping, np.random.default_rng(3))
    # single precision, and 16 bits for each number of a memory, change a reading now and then by a step or two
    assert np.mean(np.abs(reading.range - expected.range) < 1e-9) > 0.8
    assert np.array_equal(reading.status, expected.status)
    assert np.max(np.abs(reading.range - expected.range)) <= 3.5 * model.resolution


@pytest.mark.parametrize("name", ["srf08-lstm", "srf08-hybrid"])
def test_memory_lasts_from_message_to_message(name):
    model, ping = load_model(name), pings(40, sensors=4)
    whole, parts = Sensors(model, 20.0, 3), Sensors(model, 20.0, 3)
    first = [parts.answer(ping[k : k + 4])[0].range for k in range(0, 40, 4)]
    np.testing.assert_array_equal(whole.answer(ping)[0].range, np.concatenate(first))


@pytest.mark.parametrize("name", ["srf08-mlp", "srf08-lstm"])
@pytest.mark.filterwarnings("ignore::noise.ExtrapolationWarning")
def test_outside_the_learned_temperatures_readings_are_those_of_the_model(name):
    n, model = 1000, load_model(name)
    ping = Ping.of(np.full(n, 2.0), run=np.arange(n), temperature_c=40.0)
    reading, _ = Sensors(model, 20.0, 3).answer(ping)
    other = model.law(ping).sample(np.random.default_rng(4))
    assert reading.echo.mean() == pytest.approx(other.echo.mean(), abs=0.05)
    medians = [np.median(each.range[each.echo]) for each in (reading, other)]
    # within a step of the register; at the nearest learned temperature readings are 45 mm longer
    assert medians[0] == pytest.approx(medians[1], abs=1.01 * model.resolution)


def test_beyond_the_maximum_range_there_is_no_echo():
    reading, credence = Sensors(load_model("ideal"), 2.0, 0).answer(Ping.of([1.5, 2.5]))
    assert reading.echo.tolist() == [True, False]
    assert reading.range[1] == credence[1] == 0.0


@given(st.integers(0, 40), st.sampled_from([(), ("temperature_c",), ("temperature_c", "gain")]))
def test_requests_and_answers_survive_the_wire(n, names):
    ping = pings(n) if n else pings(1)[np.zeros(1, bool)]
    ping = Ping(
        ping.distance, ping.angle, ping.incidence, ping.reflectance, ping.time, ping.run,
        {name: np.arange(n, dtype=float) for name in names},
    )  # fmt: skip
    back = protocol.ping_of(protocol.ping_message(ping)[8:])
    for part in ("distance", "angle", "incidence", "reflectance", "time", "run"):
        np.testing.assert_array_equal(getattr(back, part), getattr(ping, part))
    assert list(back.covariates) == list(names)
    reading = simulate(NOISY, ping, np.random.default_rng(0))
    read, credence = protocol.reading_of(protocol.read_message(reading, np.full(n, 0.5))[8:])
    np.testing.assert_array_equal(read.range, reading.range)
    np.testing.assert_array_equal(read.status, reading.status)
    assert np.all(credence == 0.5)


def changed(column, value):
    message = bytearray(protocol.ping_message(pings(1)))
    at = 16 + 8 * protocol.CONDITIONS.index(column)
    message[at : at + 8] = struct.pack("<d", value)
    return bytes(message[4:])


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (changed("distance", -1.0), "distance must lie in [0, 1000] m, got -1 m"),
        (changed("distance", np.nan), "distance must lie in"),
        (changed("bearing", 4.0), "bearing must lie in"),
        (changed("reflectance", 1.5), "reflectance must lie in [0, 1]"),
        (changed("time", np.inf), "time must lie in"),
        (changed("sensor", 70_000.0), "sensor must lie in [0, 65535]"),
        (protocol.ping_message(pings(3))[4:-8], "need 152 bytes, got 144"),
        (b"PING" + struct.pack("<II", 2**32 - 1, 0), "4294967295 pings (at most 8192)"),
        (b"PING", "expected 8 bytes or more, got 0"),
        (b"SEED1234", "SEED with 8 bytes"),
        (b"EXEC" + b"import os", "expected PING, or SEED"),
    ],
)
def test_what_is_wrong_with_a_message_is_answered(message, text):
    reply = answer(Sensors(NOISY, 6.0, 0), message)
    assert reply[4:8] == protocol.FAIL
    assert text in reply[8:].decode()


def test_nothing_in_the_beam_is_no_echo():
    reply = answer(Sensors(load_model("ideal"), 6.0, 0), changed("distance", np.inf))
    assert not protocol.reading_of(reply[8:])[0].echo[0]


@given(st.binary(max_size=300))
def test_no_message_raises(message):
    assert answer(SENSORS, message)[4:8] in (protocol.FAIL, protocol.READ)


SENSORS = Sensors(NOISY, 6.0, 0)


def test_a_wrong_value_leaves_the_connection_open(noisy):
    with SonarClient(*noisy.address) as client:
        with pytest.raises(SettingError, match="distance must lie in"):
            client.ask(Ping.of([2000.0]))
        assert len(client.ask(pings(3))[0]) == 3


def test_clients_that_hang_vanish_or_talk_nonsense_cost_the_others_nothing(noisy):
    hanging, vanished, nonsense = raw(noisy), raw(noisy), raw(noisy)
    hanging.sendall(struct.pack("<I", 100) + b"PING")  # and nothing more
    vanished.sendall(struct.pack("<I", 100))
    vanished.close()
    nonsense.sendall(b"GET / HTTP/1.1\r\n\r\n")
    assert b"a message has" in nonsense.recv(1000)
    assert nonsense.recv(1000) == b""
    with SonarClient(*noisy.address) as client:
        begin = time.monotonic()
        assert len(client.ask(pings(64))[0]) == 64
        assert time.monotonic() - begin < 1.0
        assert hanging.recv(1000) == b""  # after its patience of 1 s
    for connection in (hanging, nonsense):
        connection.close()


def test_a_client_that_takes_no_answers_is_dropped(noisy):
    greedy = raw(noisy)
    greedy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    message = protocol.ping_message(pings(protocol.MAX_PINGS))
    with pytest.raises((ConnectionError, TimeoutError)):
        greedy.sendall(200 * message)
    greedy.close()
    with SonarClient(*noisy.address) as client:
        assert len(client.ask(pings(1))[0]) == 1


def test_too_many_clients_are_told_so(noisy):
    deadline = time.monotonic() + 10
    while noisy.clients and time.monotonic() < deadline:
        time.sleep(0.05)
    crowd = [SonarClient(*noisy.address) for _ in range(4)]
    for client in crowd:
        client.ask(pings(1))
    with SonarClient(*noisy.address) as late, pytest.raises((SettingError, UnpluggedError)):
        late.ask(pings(1))
    for client in crowd:
        client.close()


def test_it_listens_on_this_machine_only_and_a_taken_port_is_named(noisy):
    assert noisy.address[0] == "127.0.0.1"
    with pytest.raises(DeviceError, match="cannot be bound"):
        asyncio.run(SonarServer("ideal", ServerSettings(port=noisy.address[1])).run())


def test_nobody_at_an_address_is_named():
    with pytest.raises(UnpluggedError, match=r"cannot connect .* is `sonar-gym serve`"):
        SonarClient("127.0.0.1", 9)


def test_another_kind_of_server_is_recognised():
    with socket.create_server(("127.0.0.1", 0)) as other:

        def greet():
            with other.accept()[0] as connection:
                connection.sendall(b"220 mail.example.org ready\r\n")
                connection.recv(1000)

        threading.Thread(target=greet, daemon=True).start()
        with SonarClient(*other.getsockname()) as client, pytest.raises(GarbledError, match="is it a sonar server"):
            client.ask(pings(1))


def test_a_running_server_is_a_simulator_for_the_diagnosis(noisy):
    host, port = noisy.address
    ask = simulator_of(Path(f"tcp://{host}:{port}"))
    ping = Ping.of([1.0] * 1500, run=[10**6] * 1500, temperature_c=20.0)
    one, two = (ask(ping, np.random.default_rng(1)) for _ in range(2))
    np.testing.assert_array_equal(one.range, two.range)
    other = simulator_at(host, port)(ping, np.random.default_rng(2))
    assert not np.array_equal(one.range, other.range)


def lines_of(command):
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout.splitlines()


@pytest.fixture(scope="module")
def ideal():
    with Running("ideal") as server:
        yield server


IDEAL_LINES = [f"true {0.5 + 0.25 * k:.2f} m, read {0.5 + 0.25 * k:.2f} m, status 1, credence 1.00" for k in range(8)]


def test_the_python_client_of_the_documentation_reads(ideal):
    host, port = ideal.address
    assert lines_of([sys.executable, CLIENTS / "sonar_client.py", host, str(port)]) == IDEAL_LINES


def test_the_cpp_client_of_the_documentation_reads(ideal, tmp_path):
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler")
    program = tmp_path / "client"
    source = CLIENTS / "sonar_client.cpp"
    subprocess.run([compiler, "-std=c++17", "-Wall", "-Wextra", "-Werror", "-o", program, source], check=True)
    assert lines_of([program, str(ideal.address[1])]) == IDEAL_LINES
