"""Panoramas in OpenEXR: read as written, lit by them, and refused with the file's name."""

import sys

import numpy as np
import pytest

from support import SHARED

cv2 = pytest.importorskip("cv2")
OpenEXR = pytest.importorskip("OpenEXR", reason="the package OpenEXR is not installed")

from dronepose.camera import Camera  # noqa: E402
from dronepose.data.toyset import EXAMPLE_MESH  # noqa: E402
from dronepose.mesh import Mesh  # noqa: E402
from dronepose.synth.asset import Asset, AssetError  # noqa: E402
from dronepose.synth.exr import read_exr  # noqa: E402
from dronepose.synth.inputs import read_panoramas  # noqa: E402
from dronepose.synth.studio import Studio  # noqa: E402


def panorama(height=16, kind="f"):
    """Bright and red from above, dim and blue from below."""
    y, x = np.mgrid[:height, : 2 * height] / height
    light = np.stack([9 * (1 - y) ** 3 + 0.1, 0.3 + 0.2 * np.sin(3 * x), 0.1 + y], axis=-1)
    return light.astype(kind)


def write(path, channels, **header):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
    return path


@pytest.mark.parametrize("kind", ["float16", "float32"])
@pytest.mark.parametrize("name", ["NO", "RLE", "ZIPS", "ZIP", "PIZ", "DWAA", "DWAB"])
def test_colours_are_those_that_were_written(tmp_path, name, kind):
    wanted = panorama(kind=kind)
    compression = getattr(OpenEXR, f"{name}_COMPRESSION")
    found = read_exr(write(tmp_path / "a.exr", {"RGB": wanted}, compression=compression))
    assert found.dtype == np.float32
    loss = 0.05 if name.startswith("DWA") else 0
    np.testing.assert_allclose(found, wanted.astype(np.float32), atol=loss)
    if not loss:
        np.testing.assert_array_equal(found, wanted)


def test_alpha_is_left_out_and_grey_is_three_channels(tmp_path):
    wanted = panorama()
    alpha = np.concatenate([wanted, np.zeros((16, 32, 1), "f")], axis=-1)
    np.testing.assert_array_equal(read_exr(write(tmp_path / "a.exr", {"RGBA": alpha})), wanted)
    tiled = write(
        tmp_path / "b.exr", {"Y": wanted[..., 0].copy()}, type=OpenEXR.tiledimage,
        tiles=OpenEXR.TileDescription(),
    )  # fmt: skip
    np.testing.assert_array_equal(read_exr(tiled), np.repeat(wanted[..., :1], 3, axis=-1))


def test_what_compression_leaves_below_zero_is_zero(tmp_path):
    light = panorama()
    light[3, 4] = -0.002
    found = read_exr(write(tmp_path / "a.exr", {"RGB": light}))
    assert found.min() == 0
    light[3, 4] = 0
    np.testing.assert_array_equal(found, light)
    for wrong in (-1, np.inf, np.nan):
        light[3, 4] = wrong
        write(tmp_path / "a.exr", {"RGB": light})
        with pytest.raises(AssetError, match=r"a\.exr: holds a radiance that is negative or not"):
            read_panoramas(str(tmp_path))


def test_what_is_no_panorama_is_refused_by_name(tmp_path):
    plane = panorama()[..., 0].copy()
    path = write(tmp_path / "z.exr", {"Z": plane})
    with pytest.raises(AssetError, match=r"z\.exr: expected the channels R, G and B.* found Z"):
        read_exr(path)
    window = (np.array([0, 0], np.int32), np.array([63, 31], np.int32))
    write(path, {"RGB": panorama()}, displayWindow=window)
    with pytest.raises(AssetError, match=r"z\.exr: holds a part of its picture"):
        read_exr(path)
    write(path, {"RGB": panorama()[:, :20].copy()})
    with pytest.raises(AssetError, match=r"z\.exr: expected twice as wide"):
        read_panoramas(str(path))
    with pytest.raises(FileNotFoundError, match="none"):
        read_exr(tmp_path / "none.exr")


def test_a_file_that_is_cut_off_or_broken_is_refused_by_name(tmp_path):
    for name in ("NO", "ZIP", "PIZ", "DWAB"):
        compression = getattr(OpenEXR, f"{name}_COMPRESSION")
        path = write(tmp_path / "a.exr", {"RGB": panorama()}, compression=compression)
        content = path.read_bytes()
        for length in [*range(0, len(content) - 1, len(content) // 12), len(content) - 1]:
            path.write_bytes(content[:length])
            with pytest.raises(AssetError, match=r"a\.exr: cannot be read as EXR"):
                read_exr(path)
    path.write_bytes(b"#?RADIANCE\n" + content)
    with pytest.raises(AssetError, match=r"a\.exr: cannot be read as EXR"):
        read_exr(path)


def test_a_header_that_promises_too_much_is_refused(tmp_path):
    path = write(tmp_path / "a.exr", {"RGB": panorama()})
    wide = np.array([0, 0, 31, 15], "<i4").tobytes()
    content = path.read_bytes()
    assert content.count(wide) == 2  # data window and display window
    for corner in ([100_000, 50_000], [2**31 - 1, 2**31 - 1], [-5, -5]):
        path.write_bytes(content.replace(wide, np.array([0, 0, *corner], "<i4").tobytes()))
        with pytest.raises(AssetError, match=r"a\.exr: "):
            read_exr(path)


def test_without_the_package_the_error_says_what_to_do(tmp_path, monkeypatch):
    write(tmp_path / "a.exr", {"RGB": panorama()})
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(ImportError, match=r"a\.exr: .*package OpenEXR.*oiiotool a\.exr -o a\.hdr"):
        read_panoramas(str(tmp_path))


def test_a_drone_is_lit_as_by_the_same_light_in_radiance(tmp_path):
    light = panorama(64)
    exr = write(tmp_path / "exr.exr", {"RGB": light})
    cv2.imwrite(str(tmp_path / "hdr.hdr"), light[..., ::-1])
    environments, facts = read_panoramas(str(tmp_path))
    assert len(facts[exr.stem]) == 64
    assert facts["exr"] != facts["hdr"]
    scene = Asset.plain(Mesh([[-9, -9, 5], [9, -9, 5], [0, 18, 5]], [[0, 1, 2]]))
    studio = Studio(scene, [Asset.plain(Mesh.from_file(EXAMPLE_MESH), (0.7, 0.7, 0.7))])
    camera = Camera.from_fov(96, 72, horizontal_deg=64.69)
    pose = [(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([0, 0, 0.7]))]
    frames = {
        name: studio.frame(camera, (np.eye(3), np.zeros(3)), pose, environment=environments[name])
        for name in ("exr", "hdr")
    }
    on = frames["exr"].matte > 0.99
    assert on.sum() > 200
    colours = [frames[name].colour[on].astype(int) for name in ("exr", "hdr")]
    assert np.abs(colours[0] - colours[1]).max() <= 2  # of the 8 bits of Radiance's mantissa
    assert np.ptp(colours[0][:, 0]) > 100  # red, from one side


@pytest.mark.parametrize("name", ["city", "courtyard", "interior", "studio"])
def test_panoramas_of_blender_are_read(name):
    path = SHARED / "data" / "hdri" / "exr" / f"{name}.exr"
    if not path.exists():
        pytest.skip(f"{path} is not here")
    found = read_exr(path)  # DWAB
    assert found.shape == (512, 1024, 3)
    assert found.min() == 0
    assert 0.2 < found.mean() < 2
