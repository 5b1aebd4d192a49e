"""Scenes and drones as pictures: files of meshes, modalities that agree with one another."""

import numpy as np
import pytest

from support import SHARED

cv2 = pytest.importorskip("cv2")
pytest.importorskip("trimesh")
pytest.importorskip("PIL")

from dronepose import Camera, Mesh  # noqa: E402
from dronepose.data.toyset import EXAMPLE_MESH  # noqa: E402
from dronepose.render import Environment, Texture  # noqa: E402
from dronepose.synth import encode  # noqa: E402
from dronepose.synth.asset import (  # noqa: E402
    Asset,
    AssetError,
    load_asset,
    load_placements,
    merged,
)
from dronepose.synth.rooms import example_hall  # noqa: E402
from dronepose.synth.studio import DRONE, SCENE, Studio  # noqa: E402

CAMERA = Camera.from_fov(96, 72, horizontal_deg=64.69)


def look(eye, target):
    """`cam_from_world` of a level camera."""
    ahead = np.subtract(target, eye)
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(ahead, right), ahead])
    return R, -R @ np.asarray(eye, float)


# ------------------------------------------------------------------------------- files

DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
 <asset><unit meter="1" name="meter"/><up_axis>Z_UP</up_axis></asset>
 <library_images><image id="P-image"><init_from>../materials/textures/p%20q.png</init_from></image>
 </library_images>
 <library_materials><material id="m"><instance_effect url="#m-fx"/></material></library_materials>
 <library_effects><effect id="m-fx"><profile_COMMON><technique sid="s"><phong><diffuse>
  <texture texture="P-image" texcoord="C0"/></diffuse></phong></technique></profile_COMMON></effect>
 </library_effects>
 <library_geometries><geometry id="g"><mesh>
  <source id="p"><float_array id="pa" count="9">0 0 0 2 0 0 0 2 0</float_array><technique_common>
   <accessor source="#pa" count="3" stride="3"><param name="X" type="float"/>
   <param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common>
  </source>
  <source id="t"><float_array id="ta" count="6">0 0 1 0 0 1</float_array><technique_common>
   <accessor source="#ta" count="3" stride="2"><param name="S" type="float"/>
   <param name="T" type="float"/></accessor></technique_common></source>
  <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
  <triangles count="1" material="m"><input semantic="VERTEX" source="#v" offset="0"/>
   <input semantic="TEXCOORD" source="#t" offset="1" set="0"/><p>0 0 1 1 2 2</p></triangles>
 </mesh></geometry></library_geometries>
 <library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"><bind_material>
  <technique_common><instance_material symbol="m" target="#m"/></technique_common></bind_material>
 </instance_geometry></node></visual_scene></library_visual_scenes>
 <scene><instance_visual_scene url="#s"/></scene>
</COLLADA>
"""


@pytest.fixture
def model(tmp_path):
    """A model as FBX exporters write it: its texture beside, named without a sampler."""
    textures = tmp_path / "model" / "materials" / "textures"
    textures.mkdir(parents=True)
    cv2.imwrite(str(textures / "p q.png"), np.full((4, 6, 3), (0, 0, 255), np.uint8))
    path = tmp_path / "model" / "meshes" / "a.dae"
    path.parent.mkdir()
    path.write_text(DAE)
    return path


def test_collada_of_fbx_exporters_keeps_its_texture(model):
    pytest.importorskip("collada")
    asset = load_asset(model, metres_per_unit=0.5)
    assert isinstance(asset.materials[0].colour, Texture)
    assert asset.materials[0].colour.size == (4, 6)
    assert asset.materials[0].colour.mean == pytest.approx((1.0, 0.0, 0.0))
    np.testing.assert_allclose(asset.mesh.bounds, [[0, 0, 0], [1, 1, 0]])
    order = np.argsort(asset.mesh.vertices[asset.mesh.faces[0]] @ [1, 2, 0])
    np.testing.assert_allclose(asset.uv[0][order], [[0, 0], [1, 0], [0, 1]], atol=1e-6)


def test_placements_put_models_where_they_say(model):
    pytest.importorskip("collada")
    table = model.parents[2] / "placements.csv"
    head = "instance,model,mesh,metres_per_unit," + ",".join(
        f"m{i}{j}" for i in range(3) for j in range(4)
    )
    rows = [
        "one,a,model/meshes/a.dae,0.5,1,0,0,5,0,1,0,6,0,0,1,7,1,1,1",
        "two,a,model/meshes/a.dae,0.5,0,-1,0,0,1,0,0,0,0,0,1,0,2,1,1",
    ]
    table.write_text("\n".join([head + ",sx,sy,sz", *rows]) + "\n")
    (name, one), (_, two) = load_placements(table)
    assert name == "one"
    np.testing.assert_allclose(one.mesh.bounds, [[5, 6, 7], [6, 7, 7]])
    np.testing.assert_allclose(two.mesh.bounds, [[-1, 0, 0], [0, 2, 0]], atol=1e-12)
    both = merged([one, two])
    assert len(both.mesh.faces) == 2
    assert not both.materials[0].lit  # as scanned
    table.write_text("\n".join([head + ",sx,sy,sz", rows[0], rows[1].replace("-1", "x")]) + "\n")
    with pytest.raises(AssetError, match=r"placements.csv:3: column m01: .* found 'x'"):
        load_placements(table)
    table.write_text("instance,mesh\n")
    with pytest.raises(AssetError, match=r"placements\.csv:1: expected columns metres_per_unit"):
        load_placements(table)


def test_what_is_no_mesh_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_asset(tmp_path / "none.obj")
    broken = tmp_path / "a.dae"
    broken.write_text("<COLLADA><a></COLLADA>")
    with pytest.raises(AssetError, match=r"a.dae:1:\d+"):
        load_asset(broken)
    empty = tmp_path / "b.obj"
    empty.write_text("v 0 0 0\n")
    with pytest.raises(AssetError, match=r"b\.obj"):
        load_asset(empty)


def test_colours_of_faces_are_kept(tmp_path):
    path = tmp_path / "two.obj"
    (tmp_path / "two.mtl").write_text("newmtl r\nKd 1 0 0\nnewmtl g\nKd 0 0.5 0\n")
    path.write_text(
        "mtllib two.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nusemtl r\nf 1 2 3\nusemtl g\nf 2 4 3\n"
    )
    asset = load_asset(path)
    found = {asset.materials[k].colour for k in asset.material_of_face}
    assert (1.0, 0.0, 0.0) in found
    assert len(found) == 2


# --------------------------------------------------------------------------- encodings


def test_encodings_come_back():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.1, 30, (7, 9)).astype(np.float32)
    depth[0, 0] = 0
    back = encode.decode_depth(encode.read_png(encode.png(encode.encode_depth(depth))))
    np.testing.assert_allclose(back, depth, atol=0.26e-3)
    normal = rng.normal(size=(7, 9, 3)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal[1, 1] = 0
    back = encode.decode_normal(encode.read_png(encode.png(encode.encode_normal(normal))))
    np.testing.assert_allclose(back, normal, atol=2e-5)
    flow = rng.uniform(-200, 200, (7, 9, 2)).astype(np.float32)
    fate = rng.integers(0, 4, (7, 9))
    coded = encode.encode_flow(flow, fate == 1, fate == 2, fate == 3)
    back, found = encode.decode_flow(encode.read_png(encode.png(coded)))
    np.testing.assert_array_equal(found, fate)
    np.testing.assert_allclose(back[fate > 0], flow[fate > 0], atol=1 / 127)


# ------------------------------------------------------------------------------ studio


@pytest.fixture(scope="module")
def studio():
    return Studio(example_hall(), [Asset.plain(Mesh.from_file(EXAMPLE_MESH))])


VIEW = look([2.0, 1.0, 1.5], [3.0, 1.6, 1.3])
PLACE = (np.eye(3), np.array([3.0, 1.7, 1.35]))
NEXT = (np.eye(3), np.array([3.03, 1.68, 1.36]))


def test_depth_lies_on_the_walls_and_agrees_with_normals(studio):
    frame = studio.frame(CAMERA, VIEW)
    assert frame.hole == 0
    assert (frame.instance == SCENE).all()
    R, t = VIEW
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 1 + 0 * u], -1)
    points = rays * frame.depth[..., None]
    world = (points - t) @ R
    low, high = studio.scene.mesh.bounds
    assert (world > low - 1e-4).all()
    assert (world < high + 1e-4).all()
    gap = np.minimum(np.abs(world - low), np.abs(world - high)).min(axis=-1)
    assert (gap < 1e-4).mean() > 0.6  # the rest is on boxes
    across, down = points[:-1, 1:] - points[:-1, :-1], points[1:, :-1] - points[:-1, :-1]
    normal = np.cross(down, across)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    cosine = (normal * frame.normal[:-1, :-1]).sum(axis=-1)
    assert np.quantile(cosine, 0.15) > 0.9999  # all but pixels on edges
    world_normal = frame.normal @ R
    flat = np.abs(world_normal).max(axis=-1)
    np.testing.assert_allclose(flat, 1, atol=1e-5)  # walls and boxes lie along the axes


def test_the_drone_is_where_its_pose_says(studio):
    frame = studio.frame(CAMERA, VIEW, [PLACE])
    drone = frame.instance == DRONE
    assert drone.sum() > 50
    assert frame.seen == pytest.approx(1, abs=0.02)
    np.testing.assert_allclose(frame.matte[drone].mean(), 1, atol=0.35)
    v, u = np.nonzero(drone)
    centre = VIEW[0] @ PLACE[1] + VIEW[1]
    middle = [CAMERA.fx * centre[0] / centre[2] + CAMERA.cx,
              CAMERA.fy * centre[1] / centre[2] + CAMERA.cy]  # fmt: skip
    assert np.hypot(u.mean() + 0.5 - middle[0], v.mean() + 0.5 - middle[1]) < 8
    np.testing.assert_allclose(frame.depth[drone], centre[2], atol=0.4)
    behind = (np.eye(3), np.array([3.0, 9.5, 1.35]))  # outside, behind a wall
    hidden = studio.frame(CAMERA, look([3.0, 5.0, 1.5], [3.0, 9.0, 1.4]), [behind])
    assert hidden.silhouette.sum() > 5
    assert hidden.seen == 0
    assert not (hidden.instance == DRONE).any()


def test_light_falls_on_the_drone_alone(studio):
    dark, bright = (Environment(np.full((4, 8, 3), x)) for x in (0.05, 1.5))
    frames = [studio.frame(CAMERA, VIEW, [PLACE], environment=e) for e in (dark, bright)]
    drone = frames[0].matte > 0.99
    free = frames[0].matte == 0
    assert drone.any()
    assert (frames[0].colour[drone] < frames[1].colour[drone]).all()
    np.testing.assert_array_equal(frames[0].colour[free], frames[1].colour[free])


def test_flow_takes_the_next_frame_to_this_one(studio):
    camera = Camera.from_fov(160, 120, horizontal_deg=64.69)
    other = look([2.03, 1.02, 1.51], [3.0, 1.6, 1.3])
    environment = Environment(np.full((4, 8, 3), 0.8))
    first = studio.frame(camera, VIEW, [PLACE], environment=environment)
    second = studio.frame(camera, other, [NEXT], environment=environment)
    flow = studio.flow(camera, (VIEW, [PLACE]), (other, [NEXT]))
    assert flow.visible.mean() > 0.9
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float32)
    warped = cv2.remap(
        second.colour, u + flow.flow[..., 0], v + flow.flow[..., 1], cv2.INTER_LINEAR
    )
    error = np.abs(warped.astype(float) - first.colour)[flow.visible].mean()
    still = np.abs(second.colour.astype(float) - first.colour)[flow.visible].mean()
    assert error < 2.5
    assert error < 0.5 * still


def test_numbers_of_drones_must_fit(studio):
    with pytest.raises(ValueError, match="world_from_drones: expected 1, got 2"):
        studio.frame(CAMERA, VIEW, [PLACE, PLACE])
    with pytest.raises(ValueError, match="drones: expected at least one"):
        Studio(example_hall(), [])


@pytest.mark.slow
def test_the_house_is_closed_and_textured():
    folder = SHARED / "data" / "scenes" / "small_house"
    if not folder.exists():
        pytest.skip(f"{folder} is not here")
    pytest.importorskip("collada")
    parts = load_placements(folder / "placements.csv")
    house = merged([asset for _, asset in parts])
    assert len(parts) == 50
    assert len(house.mesh.faces) == 81_186
    assert sum(isinstance(m.colour, Texture) for m in house.materials) == 34
    studio = Studio(house, [Asset.plain(Mesh.from_file(EXAMPLE_MESH))])
    frame = studio.frame(CAMERA, look([-6, 0, 1.4], [-3, 2, 1.2]))
    assert frame.hole < 1e-3
    assert frame.colour.std() > 20
