"""Flights without a simulator."""

import json

import numpy as np
import pytest

from dronepose import Mesh
from dronepose.synth import Pilot, fly, make_plan, read_flight, write_example
from dronepose.synth.example import example_anchors
from dronepose.synth.rooms import example_hall
from support import run

COINS = example_anchors()


@pytest.fixture(scope="module")
def hall():
    return example_hall().mesh


@pytest.fixture(scope="module")
def flown(hall):
    return fly(COINS, hall, Pilot(seconds=40, seed=1))


def test_coins_are_collected_and_walls_are_not_met(flown, hall):
    collected = flown.facts["collected"]
    assert len({index for _, index in collected}) >= 8
    assert [second for second, _ in collected] == sorted(second for second, _ in collected)
    positions = flown.track.positions
    for second, index in collected:
        frame = min(round(second * 60), len(positions) - 1)
        assert np.linalg.norm(positions[frame] - COINS[index]) < 0.5
    low, high = hall.bounds
    assert (positions > low + 0.15).all()
    assert (positions < high - 0.15).all()
    assert 0.15 < flown.facts["nearest_wall_m"] < 2


def test_it_is_a_flight_for_the_rules(flown):
    plan = make_plan(flown.track, COINS)
    assert len(plan) > 100
    speed = np.linalg.norm(np.diff(flown.track.positions, axis=0), axis=1) * 60
    assert 0.5 < np.median(speed) < 2.5
    assert speed.max() < 4
    velocity = np.diff(flown.track.positions, axis=0)[200:, :2]
    w, x, y, z = flown.track.quat_wxyz[200:-1].T
    ahead = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)], axis=1)
    quick = np.linalg.norm(velocity, axis=1) * 60 > 1
    cosine = (ahead * velocity).sum(1) / np.linalg.norm(ahead, axis=1)
    assert np.median((cosine / np.linalg.norm(velocity, axis=1))[quick]) > 0.8  # nose ahead


def test_files_are_read_back(flown, tmp_path):
    path = tmp_path / "flight.txt"
    flown.write_tum(path)
    back = read_flight(path).resample(60.0)
    np.testing.assert_allclose(back.positions, flown.track.positions, atol=1e-6)
    dots = np.abs((back.quat_wxyz * flown.track.quat_wxyz).sum(axis=1))
    np.testing.assert_allclose(dots, 1, atol=1e-9)
    assert " seed=1 " in path.read_text().splitlines()[0]


def test_a_seed_is_a_flight(hall):
    pilot = Pilot(seconds=4, seed=7)
    one, two = (fly(COINS, hall, pilot).track.positions for _ in range(2))
    assert one.tobytes() == two.tobytes()
    assert fly(COINS, hall, Pilot(seconds=4, seed=8)).track.positions.tobytes() != one.tobytes()


def test_a_wall_across_the_way_is_told():
    wall = Mesh([[1, -9, -9], [1, 9, -9], [1, 9, 9], [1, -9, 9]], [[0, 1, 2], [0, 2, 3]])
    flown = fly([[0, 0, 1], [2, 0, 1]], wall, Pilot(seconds=3))
    assert flown.facts["unreachable"] == [1]
    assert (flown.track.positions[:, 0] < 1).all()
    for coins, message in (
        ([], "coins"),
        ([[0.0, np.nan, 0]], r"coins\[0\]: not finite"),
        ([[0.9, 0, 0]], "from a wall"),
    ):
        with pytest.raises(ValueError, match=message):
            fly(np.reshape(coins, (-1, 3)), wall)
    with pytest.raises(ValueError, match="rate_hz: found 50"):
        fly([[0, 0, 1]], pilot=Pilot(rate_hz=50))


def test_the_command_flies(tmp_path):
    coins = write_example(tmp_path)["anchors"]
    out = tmp_path / "flown.txt"
    arguments = ["synth", "fly", "--coins", coins, "--scene", "example", "--out", out]
    done = run(*arguments, "--seconds", 20, name="dronepose")
    assert done.returncode == 0, done.stderr
    assert "1201 poses" in done.stdout
    assert "to a wall" in done.stdout
    found = json.loads(run(*arguments, "--seconds", 2, "--json", name="dronepose").stdout)
    assert found["pilot"]["seconds"] == 2
    done = run(*arguments, "--variance", 3, name="dronepose")
    assert done.returncode == 1
    assert done.stderr.startswith("error: variance: found 3")
