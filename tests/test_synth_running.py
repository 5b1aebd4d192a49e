"""Rendering that is killed, that runs out of disk, that runs on a cluster: the same bits always."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from dronepose._files import beside, folder_beside, sweep, write_bytes
from support import command, run

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")

from dronepose.camera import Camera  # noqa: E402
from dronepose.mesh import obj_text  # noqa: E402
from dronepose.synth import Rules, make_plan, read_anchors, read_flight, write_example  # noqa: E402
from dronepose.synth.cluster import Cluster, _Order, render_unit  # noqa: E402
from dronepose.synth.dataset import SynthError, versions, write_dataset  # noqa: E402
from dronepose.synth.encode import read_png  # noqa: E402
from dronepose.synth.running import by_threads  # noqa: E402
from dronepose.synth.sample import RenderSettings  # noqa: E402
from dronepose.synth.sources import Sources  # noqa: E402

ROWS = 30
KILLED = """
import os, signal, sys
from pathlib import Path
from dronepose._files import beside
with beside(Path(sys.argv[1])) as part:
    part.write_bytes(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flight")
    paths = write_example(folder)
    rules = Rules(
        exo=Camera.from_fov(96, 72, horizontal_deg=64.69),
        ego=Camera.from_fov(96, 54, horizontal_deg=85.0),
    )
    flight, anchors = read_flight(paths["flight"]), read_anchors(paths["anchors"])
    made = make_plan(flight, anchors, rules, scene="hall")
    made.some(ROWS).write(folder / "plan.csv")
    return folder / "plan.csv"


def arguments(plan, out, *engine):
    engine = engine or ("--workers", 1)
    return ["synth", "render", plan, "--out", out, "--samples", 1, *engine]


@pytest.fixture(scope="module")
def whole(plan, tmp_path_factory):
    """The data set of a run that nothing stopped."""
    root = tmp_path_factory.mktemp("whole") / "data"
    done = run(*arguments(plan, root), name="dronepose")
    assert done.returncode == 0, done.stderr
    assert json.loads((root / "dataset.json").read_text())["kept"] > ROWS // 3
    return root


def names(root):
    """The names of all files, hidden ones too."""
    return [path.name for path in root.rglob("*")]


def files(root):
    """All files, hidden ones too."""
    found = (path for path in sorted(root.rglob("*")) if path.is_file())
    return {str(path.relative_to(root)): path.read_bytes() for path in found}


def records(root):
    folder = root / "records" / "hall"
    return sum(path.suffix == ".json" and path.name[0] != "." for path in folder.iterdir())


def left_by_a_kill(path, code=KILLED):
    """What a process leaves that is killed while it writes a file, or a folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    before = set(path.parent.iterdir())
    done = subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    assert done.returncode == -signal.SIGKILL
    (left,) = set(path.parent.iterdir()) - before
    return left


def test_leftovers_are_swept_and_files_being_written_are_not(tmp_path):
    left = left_by_a_kill(tmp_path / "7_flight_0_depth_exocentric_0.png")
    other = tmp_path / left.name.replace(left.name.split(".")[2], "elsewhere")
    old = tmp_path / other.name.replace("7_flight", "8_flight")
    for path in (other, old, tmp_path / "a.part.png", tmp_path / ".hidden"):
        path.write_bytes(b"")
    os.utime(old, (1e9, 1e9))
    with beside(tmp_path / "9.json") as part:
        part.write_text("{}")
        assert sweep(tmp_path) == 2
        assert part.exists()
    assert not left.exists()
    assert not old.exists()
    assert other.exists()  # perhaps of a process of another machine that is there
    assert sweep(tmp_path, lambda stem: stem.startswith("7_")) == 1
    assert sorted(names(tmp_path)) == [".hidden", "9.json", "a.part.png"]
    assert sweep(tmp_path / "none") == 0


EXPORT_KILLED = """
import os, signal, sys
from pathlib import Path
from dronepose._files import folder_beside
with folder_beside(Path(sys.argv[1])) as part:
    (part / "train").mkdir()
    (part / "train/a.png").write_bytes(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_folders_of_killed_exports_are_swept_by_the_next(tmp_path):
    left = left_by_a_kill(tmp_path / "bop", EXPORT_KILLED)
    other = tmp_path / left.name.replace(left.name.split(".")[2], "elsewhere")
    old = tmp_path / other.name.replace("bop", "shards")
    for folder in (other, old):
        shutil.copytree(left, folder)
    for path in (old / "train/a.png", old / "train", old, other / "train", other):
        os.utime(path, (1e9, 1e9))  # but other/train/a.png, which may be growing
    with folder_beside(tmp_path / "bop") as part:
        (part / "b.png").write_bytes(b"whole")
        assert {*names(tmp_path)} == {part.name, "b.png", other.name, "train", "a.png"}
        with folder_beside(tmp_path / "second"):
            assert part.exists()
    assert {*names(tmp_path)} == {"bop", "b.png", "second", other.name, "train", "a.png"}


def test_killed_at_any_moment_and_taken_up_it_is_the_same_set(plan, whole, tmp_path):
    root = tmp_path / "data"
    words = [*command("dronepose"), *map(str, arguments(plan, root))]
    for count in (0, 1, 5, 12, 20):
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while process.poll() is None:
            seen = records(root) if (root / "records/hall").is_dir() else -1
            if seen >= count:
                process.kill()
            time.sleep(0.001)
        assert process.returncode == -signal.SIGKILL
        assert count <= records(root) < ROWS
        assert not (root / "dataset.json").exists()
    for name in (
        "example/egocentric/flow/hall/29_flight_0_flow_egocentric_0.png",
        "records/hall/000029.json",
        "scenes/hall.json",
        "dataset.json",
        "data splits/scenes_train.txt",
        "trajectories/hall/flight/poses_blender.txt",
    ):
        left_by_a_kill(root / name)
    done = run(*arguments(plan, root), name="dronepose")
    assert done.returncode == 0, done.stderr
    assert files(root) == files(whole)


def test_killed_when_all_rows_are_done_it_is_finished(plan, whole, tmp_path):
    root = tmp_path / "data"
    for name, content in files(whole).items():
        if name != "dataset.json" and not name.startswith("data splits"):
            write_bytes(root / name, content)
    left_by_a_kill(root / "dataset.json")
    done = run(*arguments(plan, root), name="dronepose")
    assert f"0 of {ROWS} rows rendered now" in done.stdout
    assert files(root) == files(whole)


def test_a_full_disk_is_told_and_gone_on_from(plan, whole, tmp_path, monkeypatch):
    found = Sources(str(plan), samples=1).load(threads=1)
    written, real = [], Path.write_bytes

    def full(path, content):
        written.append(path)
        if len(written) > 200:
            real(path, content[: len(content) // 2])
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        return real(path, content)

    def write(workers):
        return write_dataset(
            tmp_path / "data", found.plan, found.studio, found.cameras, building="hall",
            drone="example", environments=found.environments, inputs=found.facts, workers=workers,
        )  # fmt: skip

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="no space is left on the disk") as caught:
        write(2)
    monkeypatch.undo()
    done = records(tmp_path / "data")
    assert 0 < done < ROWS
    assert f"; {done} of {ROWS} rows are done and whole: make room" in str(caught.value)
    assert caught.value.errno == errno.ENOSPC
    assert not any(".part" in name for name in names(tmp_path / "data"))
    write(1)
    assert files(tmp_path / "data") == files(whole)


def test_on_a_disk_that_is_truly_full(plan, whole, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=600k", "none", str(disk)]
    try:
        mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        mounted = False
    if not mounted:
        pytest.skip("a small file system cannot be mounted here")
    try:
        root = disk / "data"
        done = run(*arguments(plan, root), name="dronepose")
        assert done.returncode == 1
        count = records(root)
        assert 0 < count < ROWS
        assert done.stderr.splitlines()[-1] == (
            f"error: {root}: no space is left on the disk; {count} of {ROWS} rows are done and "
            "whole: make room, and the same command goes on from there"
        )
        for name, content in files(root).items():
            assert ".part" not in name
            if name.endswith(".png"):
                read_png(content)
        again = ["mount", "-o", "remount,size=16m", str(disk)]
        subprocess.run(again, capture_output=True, check=True)
        done = run(*arguments(plan, root), name="dronepose")
        assert done.returncode == 0, done.stderr
        assert f"{ROWS - count} of {ROWS} rows rendered now" in done.stdout
        assert files(root) == files(whole)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_what_is_asked_for_ahead_is_bounded():
    taken = []

    def items():
        for k in range(1000):
            taken.append(k)
            yield k

    results = by_threads(lambda k: k, items(), 3)
    for count in range(1, 50):
        next(results)
        assert len(taken) <= count + 6
    results.close()
    assert len(taken) < 60
    assert sorted(by_threads(abs, range(-20, 1), 4)) == list(range(21))
    with pytest.raises(ZeroDivisionError):
        list(by_threads(lambda k: 1 // k, [1, 0, 2], 2))


@pytest.fixture(scope="module")
def dask():
    """Two processes that work for a scheduler."""
    distributed = pytest.importorskip("distributed", reason="distributed is not installed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as cluster:
        cluster.wait_for_workers(2)
        yield cluster


def wait_until_idle(address):
    """Until no worker is at work on anything: files say nothing between two rows of a unit."""
    import distributed

    def running(dask_worker):  # here, so that the workers need not know this module
        return len(dask_worker.state.executing)  # cancelled ones too

    with distributed.Client(address, set_as_default=False) as client:
        until = time.monotonic() + 60
        while any(client.run(running).values()):
            assert time.monotonic() < until
            time.sleep(0.05)


def render_on(address, plan, root, **options):
    sources = Sources(os.path.relpath(plan), samples=1)
    found = sources.load(threads=1)
    return write_dataset(
        root, found.plan, found.studio, found.cameras, building="hall", drone="example",
        environments=found.environments, inputs=found.facts,
        cluster=Cluster(address, sources, rows=2), **options,
    )  # fmt: skip


def test_a_worker_of_a_cluster_is_killed_and_the_set_is_the_same(plan, whole, dask, tmp_path):
    import distributed

    with distributed.Client(dask.scheduler_address, set_as_default=False) as client:
        process = next(iter(client.run(os.getpid).values()))
    assert process != os.getpid()
    told = []

    def kill(done, total):
        told.append((done, total))
        if done and process not in killed:
            os.kill(process, signal.SIGKILL)
            killed.append(process)
            assert done < total - 10  # midway: units wait

    killed = []
    made = render_on(dask.scheduler_address, plan, tmp_path / "data", progress=kill)
    assert killed
    assert made["complete"]
    assert made["written"] == ROWS
    assert told[0] == (0, ROWS)
    assert told[-1] == (ROWS, ROWS)
    assert files(tmp_path / "data") == files(whole)


def test_the_command_renders_on_a_cluster(plan, whole, dask, tmp_path):
    words = arguments(plan, tmp_path / "data", "--dask", dask.scheduler_address)
    done = run(*words, name="dronepose")
    assert done.returncode == 0, done.stderr
    assert f"{ROWS} of {ROWS} rows rendered now" in done.stdout
    assert files(tmp_path / "data") == files(whole)
    done = run(*words, "--workers", 2, name="dronepose")
    assert done.returncode == 1
    assert "--dask, --workers: expected one of the two" in done.stderr


@pytest.fixture
def crate(tmp_path):
    """A mesh of another shape, in centimetres, x left, y up, z forward."""
    path = tmp_path / "meshes" / "crate.obj"
    path.parent.mkdir()
    corners = [[-14, -3, -9], [14, -3, -9], [0, -3, 20], [0, 9, 0]]
    path.write_text(obj_text(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], "centimetres"))
    return path


def test_a_cluster_renders_several_drones_too(plan, crate, dask, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the workers are elsewhere
    image = np.full((4, 4, 3), (200, 30, 30), np.uint8)
    cv2.imwrite(str(crate.with_name("red.png")), image)
    more = ["--more-drones", "example", crate.relative_to(tmp_path), "--more-units", 1, 0.01,
            "--more-axes", "flu", "luf", "--more-textures", "-", "meshes/red.png",
            "--apart", 0.3, "--licence", "drone_3=CC0-1.0"]  # fmt: skip
    here, there = tmp_path / "here", tmp_path / "there"
    for root, engine in ((here, ()), (there, ("--dask", dask.scheduler_address))):
        done = run(*arguments(plan, root, *engine), *more, name="dronepose")
        assert done.returncode == 0, done.stderr
        assert "no licence is known of" in done.stderr
        assert "drone_3," not in done.stderr
    facts = json.loads((there / "dataset.json").read_text())
    assert facts["drones"] == 3
    assert facts["settings"]["apart_m"] == 0.3
    assert facts["inputs"]["licences"]["drone_3"]["stated"]
    found = [json.loads(path.read_text()) for path in (there / "records/hall").iterdir()]
    assert max(record["others"] for record in found) == 2
    assert any(record["other_2_px"] for record in found)
    assert files(there) == files(here)


def test_stopping_cancels_what_waits(plan, whole, dask, tmp_path):
    class StoppedError(KeyboardInterrupt):
        pass

    def stop(done, total):
        if done:
            raise StoppedError

    root = tmp_path / "data"
    with pytest.raises(StoppedError):
        render_on(dask.scheduler_address, plan, root, progress=stop)
    wait_until_idle(dask.scheduler_address)  # a worker finishes the rows that it has begun
    there = records(root)
    assert 0 < there < ROWS
    assert not any(".part" in name for name in names(root))
    render_on(dask.scheduler_address, plan, root)
    assert files(root) == files(whole)


def test_a_cluster_that_is_not_there_is_told(plan, tmp_path):
    distributed = pytest.importorskip("distributed", reason="distributed is not installed")
    import dask.config

    with (
        dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
        pytest.raises(OSError, match=r"127\.0\.0\.1:9"),
    ):
        render_on("tcp://127.0.0.1:9", plan, tmp_path / "data")
    assert distributed.__version__
    with pytest.raises(ValueError, match="rows: expected at least 1"):
        Cluster("tcp://127.0.0.1:9", Sources(str(plan)), rows=0)


def test_workers_compare_their_inputs_and_versions(plan, tmp_path):
    sources = Sources(str(plan), samples=1).absolute()
    found = sources.load(threads=1)

    def order(inputs, of):
        place = {"building": "hall", "drone": "example", "date": "flight"}
        text = json.dumps(inputs, sort_keys=True)
        root = str(tmp_path / "data")
        return _Order(sources, root, place, found.cameras, RenderSettings(), text, of)

    wrong = {**found.facts, "plan": {**found.facts["plan"], "sha256": "0" * 64}}
    with pytest.raises(SynthError, match=r"plan\.csv: is not what .* plan\.sha256 is [0-9a-f]{64}"):
        render_unit(order(wrong, versions()), [0])
    facts = {**found.facts, "licences": {}}  # they do not matter to the pictures
    assert render_unit(order(facts, versions()), []) == 0
    with pytest.raises(SynthError, match=r"numpy .*, expected 0\.1 as where the command runs"):
        render_unit(order(found.facts, {**versions(), "numpy": "0.1"}), [0])
    assert not (tmp_path / "data").exists()
    assert render_unit(order(found.facts, {**versions(), "python": "3.0"}), [3, 4]) == 2
    before = files(tmp_path / "data")
    assert render_unit(order(found.facts, versions()), [3, 4]) == 2  # as after a worker's death
    assert files(tmp_path / "data") == before
    assert records(tmp_path / "data") == 2


def test_every_mesh_that_goes_in_is_compared(plan, crate, tmp_path):
    """By workers with the manifest, and by a run that goes on."""
    folder, text = crate.parent, crate.read_text()
    for name in ("a.obj", "b.obj"):
        (folder / name).write_text(text)
    columns = [*(f"m{r}{c}" for r in range(3) for c in range(4)), "sx", "sy", "sz"]
    ones = "0.01,1,0,0,5,0,1,0,0,0,0,1,0,1,1,1"
    placements = folder / "placements.csv"
    head = ",".join(["instance", "mesh", "metres_per_unit", *columns])
    placements.write_text(f"{head}\none,a.obj,{ones}\ntwo,b.obj,{ones}\nmore,a.obj,{ones}\n")
    sources = Sources(
        str(plan), scene=str(placements), more_drones=("example", str(crate)), more_units=(0.01,),
        samples=1,
    )  # fmt: skip
    found = sources.load(threads=1)
    assert list(found.facts["scene"]["meshes"]) == ["a.obj", "b.obj"]

    def begin():
        loaded = sources.load(threads=1)
        return write_dataset(
            tmp_path / "data", loaded.plan, loaded.studio, loaded.cameras, building="hall",
            inputs=loaded.facts, shard=(0, 1000),
        )  # fmt: skip

    begin()
    place = {"building": "hall", "drone": "drone", "date": "flight"}
    order = _Order(
        sources.absolute(), str(tmp_path / "on"), place, found.cameras, RenderSettings(),
        json.dumps(found.facts, sort_keys=True), versions(),
    )  # fmt: skip
    for path, file, name in (
        (folder / "b.obj", "placements.csv", "scene.meshes.b.obj"),
        (crate, "crate.obj", "more_drones.1.sha256"),
    ):
        path.write_text(text + "# another\n")
        with pytest.raises(SynthError, match=rf"{file}: is not what .* {name} is [0-9a-f]{{64}}"):
            render_unit(order, [0])
        with pytest.raises(SynthError, match=f"was rendered with another inputs.{name};"):
            begin()
        path.write_text(text)
    assert render_unit(order, [0]) == 1
    begin()


def test_without_distributed_the_remedy_is_named(plan, tmp_path):
    code = (
        "import sys; sys.modules['distributed'] = None\n"
        "from dronepose.commands.synth import main\n"
        f"raise SystemExit(main(['render', {str(plan)!r}, '--out', {str(tmp_path / 'd')!r}, "
        "'--dask', 'tcp://127.0.0.1:9']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert 'pip install "dronepose[cluster]"' in done.stderr
    assert "Traceback" not in done.stderr
