"""Licences of what goes into a data set: found beside the files, or stated by hand."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dronepose.synth.inputs import EXAMPLE, NO_TEXTURE

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping, Sequence

    from dronepose.synth.plan import PlanTable
    from dronepose.synth.sources import Sources

__all__ = ["find_licence", "input_licences", "recognise", "render_inputs", "unlicensed"]

OWN = "MIT"
"""Of what the project makes itself."""

_NAME = re.compile(r"(licen[sc]e|copying)", re.IGNORECASE)
_MOST_BYTES = 200_000
_SHORT = 600
_ID = r"[A-Za-z0-9.+-]+"
_EXPRESSION = re.compile(rf"{_ID}( (AND|OR|WITH) {_ID})*")
_GRANT = (
    "permission is hereby granted, free of charge, to any person obtaining a copy of this "
    "software and associated documentation files"
)
_NOTICE = "above copyright notice and this permission notice"
_BSD = "redistribution and use in source and binary forms, with or without modification"
_NAMES = "neither the name"
_ADVERTISING = "all advertising materials"
_FEE = "distribute this software for any purpose with or without fee is hereby granted"
_TEXTS: tuple[tuple[str, int, tuple[str, ...], tuple[str, ...]], ...] = (
    ("MIT", 3000, (_GRANT, _NOTICE), ()),
    ("MIT-0", 3000, (_GRANT, 'the software is provided "as is"'), (_NOTICE,)),
    ("BSD-2-Clause", 4000, (_BSD,), (_NAMES, _ADVERTISING, "patent rights")),
    ("BSD-3-Clause", 4000, (_BSD, _NAMES), (_ADVERTISING, "patent rights")),
    ("BSD-4-Clause", 4000, (_BSD, _NAMES, _ADVERTISING), ()),
    ("ISC", 2500, (_FEE, "provided that the above copyright notice"), ()),
    ("0BSD", 2500, (_FEE,), ("provided that the above copyright notice",)),
    ("Apache-2.0", 20_000, ("apache license version 2.0, january 2004",), ()),
    ("Apache-2.0", 3000, ("licensed under the apache license, version 2.0",), ()),
    ("MPL-2.0", 25_000, ("mozilla public license version 2.0", "1. definitions"), ()),
    ("BSL-1.0", 3000, ("boost software license - version 1.0",), ()),
    ("Unlicense", 3000, ("this is free and unencumbered software released into the",), ()),
    ("CC0-1.0", 12_000, ("cc0 1.0 universal",), ()),
    ("CC0-1.0", 3000, ("creativecommons.org/publicdomain/zero/1.0",), ()),
)
"""Id, length at most, phrases that are in it, and that are not."""

_CC = re.compile(
    r"attribution((?:-noncommercial|-sharealike|-noderivatives|-noderivs)*) "
    r"(\d\.\d)(?= (?:international|unported|generic))"
)
_CC_LINK = re.compile(r"creativecommons\.org/licenses/by((?:-nc|-sa|-nd)*)/(\d\.\d)")
_CC_SHORT = re.compile(r"\bcc[ -]by((?:[ -](?:nc|sa|nd))*)[ -](\d\.\d)\b")
_GNU = re.compile(r"gnu (?:lesser |affero |library )?general public license version \d")
_DENIES = re.compile(r"\b(?:not|no|except|unless)\b")
_TAG = re.compile(r"SPDX-License-Identifier:[ \t]*([^\r\n*]+)")


def recognise(text: str) -> str | None:
    """The SPDX id of a licence's text, if it is clearly one of the usual.

    MIT, MIT-0, BSD, ISC, Apache-2.0, MPL-2.0, BSL-1.0, Unlicense, CC0-1.0, Creative Commons
    Attribution and its kin, or a tag ``SPDX-License-Identifier``. Those of GNU are not named, as
    their text does not say whether later versions may be chosen.

    Args:
        text: Of the file.

    Returns:
        The id; ``None`` where there is none, or more than one.

    Example:
        >>> recognise("All files are licensed as CC BY 4.0."), recognise("Ask me.")
        ('CC-BY-4.0', None)
    """
    plain = re.sub(r"[\s*`#>_]+", " ", text).lower()
    plain = re.sub(r"[“”„]|''", '"', plain).strip()
    plain = re.sub(r"(\(the \"license\"\)|\(c\))", " ", plain)
    found = {
        name
        for name, most, wanted, unwanted in _TEXTS
        if len(plain) <= most
        and all(phrase in plain for phrase in wanted)
        and not any(phrase in plain for phrase in unwanted)
    }
    if len(plain) <= 25_000:
        found |= {_attribution(*match.groups()) for match in _CC.finditer(plain)}
    if len(plain) <= _SHORT and not _DENIES.search(plain):
        for pattern in (_CC_LINK, _CC_SHORT):
            found |= {_attribution(*match.groups()) for match in pattern.finditer(plain)}
        if re.search(r"\bcc0\b", plain):
            found.add("CC0-1.0")
        tags = {match[1].strip() for match in _TAG.finditer(text)}
        found |= {tag for tag in tags if _EXPRESSION.fullmatch(tag)}
    if _GNU.search(plain):
        found.add("GNU")
    return found.pop() if len(found) == 1 and "GNU" not in found else None


def _attribution(kind: str, version: str) -> str:
    """The id of a Creative Commons licence from words or letters."""
    kind = re.sub(r"[ -]+", "-", kind)
    for word, letters in (
        ("noncommercial", "nc"), ("sharealike", "sa"), ("noderivatives", "nd"), ("noderivs", "nd"),
    ):  # fmt: skip
        kind = kind.replace(word, letters)
    return f"CC-BY{kind.upper()}-{version}"


def find_licence(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The licence of an input: files ``LICENSE*``, ``LICENCE*`` or ``COPYING*``, in any case.

    They are looked for beside the input, then in the folder above, then in the one above that; the
    first of these folders that has any is taken.

    Args:
        path: The input, a file or a folder.

    Returns:
        ``files``, each with its name as seen from the input's folder, SHA-256 and ``spdx``, and
        ``spdx``: that of all of them, or ``None``.

    Raises:
        OSError: A file that was found cannot be read.

    Example:
        >>> find_licence("examples/quadrotor.obj")["spdx"]
        'MIT'
    """
    start = Path(path).absolute()
    folder = start if start.is_dir() else start.parent
    for above in range(3):
        files = _beside(folder)
        if files:
            said = [_facts(file, "../" * above) for file in files]
            ids = {one["spdx"] for one in said}
            return {"spdx": ids.pop() if len(ids) == 1 else None, "files": said}
        folder = folder.parent
    return {"spdx": None, "files": []}


def _beside(folder: Path) -> list[Path]:
    try:
        return sorted(f for f in folder.iterdir() if _NAME.match(f.name) and f.is_file())
    except OSError:  # a folder that may not be looked into
        return []


def _facts(file: Path, lead: str) -> dict[str, Any]:
    content = file.read_bytes()
    short = len(content) <= _MOST_BYTES
    spdx = recognise(content.decode("utf-8", errors="replace")) if short else None
    digest = hashlib.sha256(content).hexdigest()
    return {"file": lead + file.name, "sha256": digest, "spdx": spdx}


def input_licences(
    files: Mapping[str, str | os.PathLike[str] | None], stated: Sequence[str] = ()
) -> dict[str, dict[str, Any]]:
    """The licence of each input, for the manifest.

    Args:
        files: By the input's name; ``"example"`` is the project's own, ``None`` a file that is not
            here any more.
        stated: ``NAME=ID`` each, an SPDX id or expression; it wins over what is found.

    Returns:
        By name ``spdx``, or ``None``; ``files`` as of :func:`find_licence`; and ``stated``, where
        it was.

    Raises:
        ValueError: A statement is of another form, or of an input that there is not.
        OSError: A file that was found cannot be read.

    Example:
        >>> input_licences({"scene": "example", "drone": None}, ["drone=CC-BY-4.0"])["drone"]
        {'spdx': 'CC-BY-4.0', 'files': [], 'stated': True}
    """
    said: dict[str, str] = {}
    for text in stated:
        name, equals, spdx = text.partition("=")
        if not equals or not _EXPRESSION.fullmatch(spdx):
            raise ValueError(f"--licence: expected NAME=ID, such as scene=CC-BY-4.0, got {text!r}")
        if name not in files:
            raise ValueError(f"--licence: expected one of {', '.join(files)}, got {name!r}")
        said[name] = spdx
    found: dict[str, dict[str, Any]] = {}
    for name, file in files.items():
        if file is None:
            found[name] = {"spdx": None, "files": []}
        elif file == EXAMPLE:
            found[name] = {"spdx": OWN, "files": [], "made_by": "dronepose"}
        else:
            found[name] = find_licence(file)
        if name in said:
            found[name] |= {"spdx": said[name], "stated": True}
    return found


def render_inputs(sources: Sources, plan: PlanTable) -> dict[str, str | os.PathLike[str] | None]:
    """The inputs of a data set by name, for :func:`input_licences`.

    Args:
        sources: Their files.
        plan: The plan, whose manifest names flight and anchors.

    Returns:
        The files; that of the flight or the anchors is ``None`` where it is not there any more,
        or another.
    """
    found: dict[str, Any] = {"scene": sources.scene, "drone": sources.drone}
    if sources.drone_texture is not None:
        found["drone_texture"] = sources.drone_texture
    textures = [*sources.more_textures, *[NO_TEXTURE] * len(sources.more_drones)]
    for k, (drone, texture) in enumerate(zip(sources.more_drones, textures, strict=False), 2):
        found[f"drone_{k}"] = drone
        if texture != NO_TEXTURE:
            found[f"drone_{k}_texture"] = texture
    found["panoramas"] = sources.panoramas or EXAMPLE
    for name in ("flight", "anchors"):
        source = (plan.manifest.get(name) or {}).get("source") or {}
        if "sha256" in source:
            found[name] = _still_there(source, Path(sources.plan).parent)
    return found


def _still_there(source: Mapping[str, Any], folder: Path) -> Path | None:
    """The file of a manifest, as it is named or beside the plan, if it is the same."""
    named = Path(str(source.get("path", "")))
    for path in (named, folder / named, folder / named.name):
        if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == source["sha256"]:
            return path
    return None


def unlicensed(inputs: Mapping[str, Any]) -> list[str]:
    """The inputs of a manifest of which no licence is known.

    Args:
        inputs: Of ``scenes/BUILDING.json``.

    Returns:
        Their names; none where licences were not looked for.

    Example:
        >>> unlicensed({"licences": {"scene": {"spdx": None}, "drone": {"spdx": "MIT"}}})
        ['scene']
    """
    known = inputs.get("licences")
    entries = known.items() if isinstance(known, dict) else ()
    return [name for name, of in entries if not (isinstance(of, dict) and of.get("spdx"))]
