"""A network without weights, as ONNX: the drone is 1 m away where the picture is bright."""

import numpy as np

from dronepose import Camera
from dronepose.model.metadata import encode

CAMERA = Camera(60.0, 55.0, 31.0, 25.0, width=64, height=48)


def write(path, *, aware=False, camera=CAMERA, size=None, names=("R", "t"), **metadata):
    """Write it; for ``aware`` it uses its input ``K``, otherwise the camera given here."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    height, width = size or (camera.height, camera.width)
    nodes, constants = [], []

    def constant(value, dtype=np.float32):
        name = f"c{len(constants)}"
        constants.append(numpy_helper.from_array(np.asarray(value, dtype=dtype), name))
        return name

    def node(kind, *inputs, output=None, **attributes):
        name = output or f"n{len(nodes)}"
        nodes.append(helper.make_node(kind, inputs, [name], **attributes))
        return name

    def axes(*values):
        return constant(values, np.int64)

    u = constant(np.arange(width) + 0.5)
    v = constant((np.arange(height) + 0.5)[:, None])
    total = node("ReduceSum", "image", axes(1, 2, 3), keepdims=0)
    centre = [
        node("Div", node("ReduceSum", node("Mul", "image", w), axes(1, 2, 3), keepdims=0), total)
        for w in (u, v)
    ]

    def entry(row, column):
        if not aware:
            return constant(camera.K[row, column])
        of_row = node("Gather", "K", constant(row, np.int64), axis=1)
        return node("Gather", of_row, constant(column, np.int64), axis=1)

    x = node("Div", node("Sub", centre[0], entry(0, 2)), entry(0, 0))
    y = node("Div", node("Sub", centre[1], entry(1, 2)), entry(1, 1))
    columns = [node("Unsqueeze", c, axes(1)) for c in (x, y, node("Div", total, total))]
    node("Concat", *columns, axis=1, output=names[1])
    batch = node("Gather", node("Shape", "image"), axes(0), axis=0)
    shape = node("Concat", batch, axes(3, 3), axis=0)
    node("Expand", constant(np.eye(3)[None]), shape, output=names[0])

    def value(name, *shape):
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["B", *shape])

    inputs = [value("image", 3, height, width), *([value("K", 3, 3)] if aware else [])]
    outputs = [value(names[0], 3, 3), value(names[1], 3)]
    graph = helper.make_graph(nodes, "finder", inputs, outputs, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)
    metadata = {
        "architecture": {"camera": "normalised" if aware else None},
        "image_size": (height, width),
        **({} if metadata.pop("blind", False) else {"intrinsics": camera.K}),
        **metadata,
    }
    helper.set_model_props(model, encode(metadata))
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return path


def spot(height, width, u, v, radius):
    """A frame with a bright disc around a point, smooth at its edge."""
    rows, columns = np.mgrid[:height, :width] + 0.5
    bright = np.clip(radius - np.hypot(columns - u, rows - v) + 0.5, 0, 1)
    return np.repeat(np.rint(255 * bright).astype(np.uint8)[..., None], 3, axis=2)
