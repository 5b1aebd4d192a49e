"""Every public name is documented: arguments, result, errors, and an example that runs."""

import doctest
import importlib
import importlib.util
import inspect
import pkgutil
import re
import signal

import pytest

import dronepose
from dronepose import geometry, metrics, render, synth
from support import ROOT

MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(dronepose.__path__, "dronepose.")
    if module.name != "dronepose._native"
)
PUBLIC = {
    **{f"dronepose.{name}": getattr(dronepose, name) for name in dronepose.__all__},
    **{f"metrics.{name}": getattr(metrics, name) for name in metrics.__all__},
    **{f"geometry.{name}": getattr(geometry, name) for name in geometry.__all__},
    **{f"render.{name}": getattr(render, name) for name in render.__all__},
    **{f"synth.{name}": getattr(synth, name) for name in synth.__all__},
}
if importlib.util.find_spec("torch"):
    PUBLIC |= {f"torch.{n}": getattr(dronepose.torch, n) for n in dronepose.torch.__all__}
if importlib.util.find_spec("lightning"):
    for part in ("data", "infer", "losses", "model"):
        module = importlib.import_module(f"dronepose.{part}")
        PUBLIC |= {f"{part}.{n}": getattr(module, n) for n in module.__all__}
del PUBLIC["dronepose.__version__"]


@pytest.mark.parametrize("name", ["dronepose", *MODULES])
def test_examples_run(name, monkeypatch):
    monkeypatch.chdir(ROOT)
    handler = signal.getsignal(signal.SIGINT)  # the command takes it away
    try:
        done = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    finally:
        signal.signal(signal.SIGINT, handler)
    assert done.failed == 0


def functions():
    for name, value in PUBLIC.items():
        if inspect.isfunction(value):
            yield name, value
        elif inspect.isclass(value) and value.__module__.startswith("dronepose."):
            for key, member in vars(value).items():
                if key.startswith("_"):
                    continue
                if isinstance(member, classmethod | staticmethod):
                    member = member.__func__
                if isinstance(member, property):
                    member = member.fget
                if inspect.isfunction(member):
                    yield f"{name}.{key}", member


FUNCTIONS = dict(functions())


@pytest.mark.parametrize("name", PUBLIC)
def test_public_names_are_documented(name):
    assert inspect.getdoc(PUBLIC[name])


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_have_their_sections(name):
    function = FUNCTIONS[name]
    text = inspect.getdoc(function) or ""
    assert re.search(r"^Example:\n(.*\n)*? +>>> ", text, re.MULTILINE), "no example"
    parameters = [p for p in inspect.signature(function).parameters if p not in ("self", "cls")]
    for parameter in parameters:
        assert re.search(rf"^ +{parameter}: ", text, re.MULTILINE), f"{parameter} is missing"
    if parameters:
        assert "Returns:\n" in text
        assert "Raises:\n" in text


def test_modules_re_export_everything_public():
    for module in (metrics, geometry):
        public = {
            name
            for part in MODULES
            if part.startswith(f"{module.__name__}.") or part == module.__name__
            for name, value in vars(importlib.import_module(part)).items()
            if (inspect.isfunction(value) or inspect.isclass(value))
            and not name.startswith("_")
            and value.__module__ == part
            and "._" not in part
        }
        assert public - {"native_symmetries"} <= set(module.__all__)
