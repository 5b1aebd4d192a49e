"""Licences of the inputs: recognised, found beside the files, stated, missed."""

import hashlib
import json
import shutil

import pytest

from support import ROOT, SHARED, run

pytest.importorskip("cv2")
pytest.importorskip("trimesh")

from dronepose.data.toyset import EXAMPLE_MESH
from dronepose.synth.doctor import check_dataset
from dronepose.synth.licences import find_licence, input_licences, recognise
from synth_set import write_tiny

MIT = (ROOT / "LICENSE").read_text(encoding="utf-8")
NOTICE = MIT[MIT.index("The above copyright") : MIT.index("THE SOFTWARE IS PROVIDED")]
BSD = """Copyright (c) 2001, Somebody
Redistribution and use in source and binary forms, with or without modification, are permitted
provided that the following conditions are met: ...
"""
NAMES = "Neither the name of the copyright holder nor the names of its contributors may be used"
ISC = """Permission to use, copy, modify, and/or distribute this software for any purpose with or
without fee is hereby granted{} ..."""
APACHE = """                                 Apache License
                           Version 2.0, January 2004
                        http://www.apache.org/licenses/"""


@pytest.mark.parametrize(
    ("text", "spdx"),
    [
        (MIT, "MIT"),
        (MIT.replace("\n", "\r\n").replace('"', "\u201c"), "MIT"),
        (MIT.replace(NOTICE, ""), "MIT-0"),
        (BSD, "BSD-2-Clause"),
        (f"{BSD} * {NAMES}", "BSD-3-Clause"),
        (f"{BSD} All advertising materials ... {NAMES}", "BSD-4-Clause"),
        (f"{BSD} {NAMES} no license to any party's patent rights", None),
        (ISC.format(", provided that the above copyright notice and this"), "ISC"),
        (ISC.format("."), "0BSD"),
        (APACHE + 11_000 * "x", "Apache-2.0"),
        ('Licensed under the Apache License, Version 2.0 (the "License");', "Apache-2.0"),
        ("Creative Commons Legal Code\n\nCC0 1.0 Universal\n" + 6000 * "x", "CC0-1.0"),
        ("All HDRIs are licenses as CC0.", "CC0-1.0"),
        ("This is not CC0.", None),
        ("Attribution 4.0 International\n" + 17_000 * "x", "CC-BY-4.0"),
        ("Attribution-NonCommercial-ShareAlike 4.0 International\n", "CC-BY-NC-SA-4.0"),
        ("Creative Commons Attribution-NoDerivs 3.0 Unported", "CC-BY-ND-3.0"),
        ("under [CC BY 4.0](https://creativecommons.org/licenses/by/4.0/legalcode)", "CC-BY-4.0"),
        ("CC-BY-SA-4.0, see https://creativecommons.org/licenses/by-sa/4.0/", "CC-BY-SA-4.0"),
        ("CC BY 4.0 or CC BY-NC 4.0", None),
        ("SPDX-License-Identifier: MIT OR Apache-2.0\n", "MIT OR Apache-2.0"),
        ("SPDX-License-Identifier: what you like!\n", None),
        ("GNU GENERAL PUBLIC LICENSE\n Version 3, 29 June 2007", None),
        (f"{MIT}\n{BSD}", None),
        (MIT + 3000 * "And we keep all the rest. ", None),
        ("All rights reserved.", None),
        ("", None),
    ],
)
def test_texts_are_recognised_if_they_are_clearly_one(text, spdx):
    assert recognise(text) == spdx


@pytest.mark.parametrize(
    ("path", "spdx"),
    [
        ("drones/skydio_x2/assets/X2_lowpoly.obj", "Apache-2.0"),
        ("drones/dji_mavic2/DJI.obj", "MIT"),
        ("drones/hector/quadrotor_base.stl", "BSD-3-Clause"),
        ("scenes/cafe/meshes/cafe.dae", "CC-BY-3.0"),
        ("scenes/small_house/placements.csv", "MIT-0"),
        ("hdri/exr", "CC0-1.0"),
    ],
)
def test_files_of_others_are_recognised(path, spdx):
    if not (SHARED / "data" / path).exists():
        pytest.skip(f"{SHARED / 'data' / path} is not here")
    assert find_licence(SHARED / "data" / path)["spdx"] == spdx


def test_the_nearest_folder_with_a_licence_counts(tmp_path):
    deep = tmp_path / "a" / "b" / "c"
    deep.mkdir(parents=True)
    file = deep / "scene.glb"
    file.write_bytes(b"")
    (tmp_path / "LICENSE").write_text(MIT)  # three above
    assert find_licence(file) == {"spdx": None, "files": []}
    (tmp_path / "a" / "licence.md").write_text("Ask me.")
    said = find_licence(file)
    assert said["spdx"] is None
    assert [one["file"] for one in said["files"]] == ["../../licence.md"]
    (tmp_path / "a" / "b" / "LICENSES").mkdir()  # a folder is none
    (tmp_path / "a" / "b" / "COPYING").write_bytes(b"\xff\xfe" + MIT.encode())
    (tmp_path / "a" / "b" / "License.txt").write_text(MIT)
    digest = hashlib.sha256(MIT.encode()).hexdigest()
    said = find_licence(file)
    assert said["spdx"] == "MIT"
    assert said["files"][1] == {"file": "../License.txt", "sha256": digest, "spdx": "MIT"}
    (deep / "LICENSE-APACHE").write_text(APACHE)
    (deep / "LICENSE-MIT").write_text(MIT)
    assert find_licence(file)["spdx"] is None  # one of two, or both
    assert find_licence(deep) == find_licence(file)
    (deep / "LICENSE-MIT").unlink()
    assert find_licence(file)["spdx"] == "Apache-2.0"


def test_what_is_stated_wins(tmp_path):
    (tmp_path / "LICENSE").write_text(MIT)
    files = {"scene": tmp_path / "a.glb", "drone": "example", "flight": None}
    found = input_licences(files, ["scene=CC-BY-4.0"])
    assert found["scene"]["spdx"] == "CC-BY-4.0"
    assert found["scene"]["stated"]
    assert found["scene"]["files"][0]["spdx"] == "MIT"
    assert found["drone"] == {"spdx": "MIT", "files": [], "made_by": "dronepose"}
    assert found["flight"]["spdx"] is None
    for wrong, message in (
        ("scene", "expected NAME=ID"),
        ("scene=a b", "expected NAME=ID"),
        ("roof=MIT", "expected one of scene, drone, flight, got 'roof'"),
    ):
        with pytest.raises(ValueError, match=message):
            input_licences(files, [wrong])


def test_the_command_writes_licences_and_they_may_be_stated_later(tmp_path):
    made, _ = write_tiny(tmp_path, rows=2)
    assert not check_dataset(made)["manifest"].note  # nobody has looked for any
    plan, data, inputs = tmp_path / "plan.csv", tmp_path / "set", tmp_path / "inputs"
    (inputs / "meshes").mkdir(parents=True)
    shutil.copy(EXAMPLE_MESH, inputs / "meshes/x.obj")
    (inputs / "LICENSE").write_text(MIT)
    facts = json.loads(plan.with_suffix(".json").read_text())
    assert (tmp_path / "flight.txt").samefile(facts["flight"]["source"]["path"])
    (tmp_path / "anchors.csv").write_text("id,x,y,z\n")  # another than the plan's
    command = ["synth", "render", plan, "--drone", inputs / "meshes/x.obj", "--out", data,
               "--samples", 1]  # fmt: skip
    done = run(*command, "--json", name="dronepose")
    assert done.returncode == 0, done.stderr
    assert "no licence is known of flight, anchors; --licence NAME=ID" in done.stderr
    said = json.loads(done.stdout)["inputs"]["licences"]
    assert {name: one["spdx"] for name, one in said.items()} == {
        "scene": "MIT", "drone": "MIT", "panoramas": "MIT", "flight": None, "anchors": None,
    }  # fmt: skip
    assert said["drone"]["files"][0]["file"] == "../LICENSE"
    note = check_dataset(data, mesh=str(EXAMPLE_MESH))["manifest"].note
    assert note == "no licence is known of anchors, flight (synth render --licence)"
    states = ["--licence", "flight=CC0-1.0", "--licence", "anchors=MIT"]
    done = run(*command, *states, name="dronepose")
    assert "0 of 2 rows rendered now" in done.stdout
    assert "licence" not in done.stderr
    for path in (data / "dataset.json", data / "scenes/hall.json"):
        said = json.loads(path.read_text())["inputs"]["licences"]
        assert (said["flight"]["spdx"], said["flight"]["stated"]) == ("CC0-1.0", True)
    found = check_dataset(data, mesh=str(EXAMPLE_MESH))["manifest"]
    assert (found.ok, found.note) == (True, "")
    done = run(*command, "--licence", "roof=MIT", name="dronepose")
    assert (done.returncode, "--licence: expected one of scene" in done.stderr) == (1, True)
    done = run(*command, "--drone-unit", 2, name="dronepose")
    assert "was rendered with another inputs" in done.stderr
