"""The columns of the paper's table of data sets for a data set that was rendered here."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dronepose.synth.export import complete_scenes
from dronepose.synth.layout import MODALITIES
from dronepose.synth.licences import unlicensed

if TYPE_CHECKING:
    import os

    from dronepose.synth.reading import SceneFolder

__all__ = ["PAPER", "DataTable", "data_table"]

ROWS = (
    "Number of trajectories",
    "Environments",
    "Resolution",
    "Data type",
    "Egocentric views",
    "Exocentric views",
    "Environment type",
    "6D pose",
    "IMU data",
    "Depth map",
    "Surface normals",
    "Scene semantics",
    "Optical flow",
    "Silhouettes",
)
"""The rows of the paper's table, in its order."""

PAPER = {
    "UAVA": (
        "90", "90", "320x240 320x180", "photorealistic", "Yes", "Yes", "Indoor",
        "Yes", "No", "Yes", "Yes", "No", "Yes", "Yes",
    ),
    "Mid-Air": (
        "54", "2", "1024x1024", "synthetic", "Yes", "No", "Outdoor",
        "No", "Yes", "Yes", "Yes", "Yes", "No", "No",
    ),
    "EuRoC MAV": (
        "11", "2", "752x460", "real", "Yes", "No", "Indoor",
        "Yes", "Yes", "Yes", "No", "No", "No", "No",
    ),
    "Blackbird": (
        "17", "5", "1024x768", "synthetic", "Yes", "No", "Indoor",
        "Yes", "Yes", "No", "No", "No", "No", "No",
    ),
}  # fmt: skip
"""The columns as the paper's supplement has them, "Comparison of the provided dataset"."""

SOURCES = {
    "UAVA": (
        "albanis2020dronepose",
        "Albanis et al., DronePose: Photorealistic UAV-Assistant Dataset Synthesis for 3D Pose "
        "Estimation via a Smooth Silhouette Loss, ECCV Workshops 2020",
    ),
    "Mid-Air": (
        "fonder2019mid",
        "Fonder and Van Droogenbroeck, Mid-Air: A multi-modal dataset for extremely low altitude "
        "drone flights, CVPR Workshops 2019",
    ),
    "EuRoC MAV": (
        "burri2016euroc",
        "Burri et al., The EuRoC micro aerial vehicle datasets, IJRR 35(10), 2016",
    ),
    "Blackbird": (
        "antonini2018blackbird",
        "Antonini et al., The Blackbird Dataset: A large-scale dataset for UAV perception in "
        "aggressive flight, arXiv:1810.01987, 2018",
    ),
}
"""Key and reference of each."""

_NOTE = 'UAVA to Blackbird as in the supplement of {}, "Comparison of the provided dataset".'
_SHOWN = {
    "Depth map": "depth",
    "Surface normals": "normal_map",
    "Scene semantics": "semantics",
    "Optical flow": "flow",
    "Silhouettes": "silhouette",
}


@dataclass(frozen=True, slots=True)
class DataTable:
    """What a data set has: see :func:`data_table`.

    Args:
        name: The head of its column.
        values: By row, those of the paper first, then ours.
        facts: The same as numbers, for JSON.
    """

    name: str
    values: dict[str, str]
    facts: dict[str, Any]

    def lines(self) -> list[tuple[str, ...]]:
        """Cells by row: its name, this data set, the paper's four; the latter know its rows alone.

        Returns:
            The lines, the first of which is the head.

        Raises:
            Nothing.

        Example:
            >>> DataTable("mine", dict.fromkeys(ROWS, "?"), {}).lines()[0][:3]
            ('', 'mine', 'UAVA')
        """
        found: list[tuple[str, ...]] = [("", self.name, *PAPER)]
        for row, value in self.values.items():
            known = row in ROWS
            others = [column[ROWS.index(row)] if known else "" for column in PAPER.values()]
            found.append((row, value, *others))
        return found

    def markdown(self) -> str:
        """The table in Markdown, with references.

        Returns:
            The text.

        Raises:
            Nothing.

        Example:
            >>> DataTable("mine", {"Environments": "3"}, {}).markdown().splitlines()[2]
            '| Environments | 3 | 90 | 2 | 2 | 5 |'
        """
        head, *rows = self.lines()
        head = (*head[:2], *(f"{name} [{k}]" for k, name in enumerate(head[2:], 1)))
        cells = [[cell.replace("|", "\\|") for cell in row] for row in (head, *rows)]
        lines = ["| " + " | ".join(row) + " |" for row in cells]
        lines.insert(1, "|" + "---|" * len(head))
        notes = [f"[{k}] {text}." for k, (_, text) in enumerate(SOURCES.values(), 1)]
        return (
            "\n".join(
                [*lines, "", _NOTE.format("[1]"), "", *(f"{note}  " for note in notes)]
            ).rstrip()
            + "\n"
        )

    def latex(self) -> str:
        r"""The table in LaTeX, with the citations' keys of the paper.

        Returns:
            A ``tabular``; the references of the keys are comments before it.

        Raises:
            Nothing.

        Example:
            >>> DataTable("a_b", {"Environments": "3"}, {}).latex().splitlines()[-2]
            'Environments & 3 & 90 & 2 & 2 & 5 \\\\'
        """
        head, *rows = self.lines()
        keys = ("", "", *(rf"\cite{{{key}}}" for key, _ in SOURCES.values()))
        lines = [f"% {key}: {text}" for key, text in SOURCES.values()]
        lines += [f"% {_NOTE.format(keys[2])}", rf"\begin{{tabular}}{{l{'c' * (len(head) - 1)}}}"]
        titles = [_escaped(name) + key for name, key in zip(head, keys, strict=True)]
        lines += [" & ".join(titles) + r" \\", r"\hline"]
        lines += [" & ".join(map(_escaped, row)) + r" \\" for row in rows]
        return "\n".join([*lines, r"\end{tabular}"]) + "\n"


def _escaped(text: str) -> str:
    special = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    special |= {letter: "\\" + letter for letter in "&%$#_{}"}
    return "".join(special.get(letter, letter) for letter in text)


def data_table(
    root: str | os.PathLike[str],
    *,
    name: str | None = None,
    environment: str = "unknown",
    data_type: str = "synthetic",
) -> DataTable:
    """What a rendered data set has, in the rows of the paper's table of data sets.

    DronePose, supplement, "Comparison of the provided dataset with other UAVs datasets". All is
    counted in the folder: a view or a modality is there if every kept sample has its images of both
    times (``partly`` if only some have). Environments are the scenes' files, of which two buildings
    may share one. Semantics would be images of a modality ``semantics``, IMU data files ``imu*``
    beside a trajectory; nothing here writes them.

    Args:
        root: The data set.
        name: The head of its column; ``None`` is the folder's name.
        environment: Such as ``Indoor``; no file says it.
        data_type: Such as ``photorealistic``, which the paper calls renderings of scans.

    Returns:
        The table, with samples, drones, splits and licences below the paper's rows.

    Raises:
        FileNotFoundError: The folder holds no rendered data set, or a trajectory is missing.
        SynthError: A scene is not complete, or no sample was kept.
        OSError: A file cannot be read.

    Example:
        >>> print(data_table("synth", environment="Indoor").markdown())  # doctest: +SKIP
    """
    root = Path(root)
    scenes = complete_scenes(root)
    samples = {scene.building: [record["row"] for record in kept] for scene, kept in scenes}
    counts = {view: _modalities(root, view, scenes, samples) for view in MODALITIES}
    total = sum(map(len, samples.values()))
    posed = sum(
        row < len(moments.t)
        for scene, _ in scenes
        for moments in [scene.moments()]
        for row in samples[scene.building]
    )
    imu = [path for scene, _ in scenes for path in scene.flight.parent.glob("imu*")]
    splits: dict[str, Counter[str]] = {}
    for scene, kept in scenes:
        splits.setdefault(scene.split, Counter()).update(scenes=1, samples=len(kept))
    drones = sorted({drone for scene, _ in scenes for drone in _drones(scene)})
    at_once = {int(scene.facts.get("drones", 1)) for scene, _ in scenes}
    lacking = sorted({n for s, _ in scenes for n in unlicensed(s.facts.get("inputs", {}))})
    facts: dict[str, Any] = {
        "name": name if name is not None else root.resolve().name,
        "trajectories": len({scene.flight for scene, _ in scenes}),
        "environments": len({_environment(scene) for scene, _ in scenes}),
        "resolution": _resolutions([scene for scene, _ in scenes], counts),
        "data_type": data_type,
        "environment_type": environment,
        "poses": posed,
        "imu_files": len(imu),
        "images": counts,
        "samples": total,
        "rows": sum(int(scene.facts["rows"]) for scene, _ in scenes),
        "drones": drones,
        "drones_in_a_picture": max(at_once),
        "splits": {split: dict(count) for split, count in sorted(splits.items())},
        "licences": _licences([scene for scene, _ in scenes]),
        "without_licence": lacking,
    }
    return DataTable(facts["name"], _values(facts, 2 * total), facts)


def _values(facts: dict[str, Any], wanted: int) -> dict[str, str]:
    """The cells of the column, from the facts."""
    counts = facts["images"]

    def there(modality: str, views: tuple[str, ...] = tuple(MODALITIES)) -> str:
        found = [counts[view].get(modality, 0) for view in views]
        if wanted in found:
            return "Yes"
        return "partly" if any(found) else "No"

    sizes = [size for size in facts["resolution"].values() if size]
    values = {
        "Number of trajectories": str(facts["trajectories"]),
        "Environments": str(facts["environments"]),
        "Resolution": " ".join(dict.fromkeys(size for several in sizes for size in several)),
        "Data type": facts["data_type"],
        "Egocentric views": there("colour", ("egocentric",)),
        "Exocentric views": there("colour", ("exocentric",)),
        "Environment type": facts["environment_type"],
        "6D pose": "Yes" if 2 * facts["poses"] == wanted else "partly" if facts["poses"] else "No",
        "IMU data": "Yes" if facts["imu_files"] else "No",
        **{row: there(modality) for row, modality in _SHOWN.items()},
    }
    several = facts["drones_in_a_picture"]
    beside = f", up to {several} in a picture" if several > 1 else ""
    splits = [
        f"{split} {count['samples']} ({count['scenes']} scene{'s' if count['scenes'] > 1 else ''})"
        for split, count in facts["splits"].items()
    ]
    licences = ", ".join(facts["licences"]) or "not looked for"
    if facts["without_licence"]:
        licences += f"; unknown of {', '.join(facts['without_licence'])}"
    return values | {
        "Samples kept": f"{facts['samples']} of {facts['rows']}, each at two times",
        "Drones": f"{len(facts['drones'])} ({', '.join(facts['drones'])}){beside}",
        "Splits": ", ".join(splits),
        "Licences of inputs": licences,
    }


def _modalities(
    root: Path,
    view: str,
    scenes: list[tuple[SceneFolder, list[dict[str, Any]]]],
    samples: dict[str, list[int]],
) -> dict[str, int]:
    """How many images of the kept samples there are of each modality of a view."""
    found: Counter[str] = Counter()
    for scene, _ in scenes:
        folder = root / str(scene.facts["drone"]) / view
        modalities = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
        for modality in modalities:
            place = folder / modality / scene.building
            names = {path.name for path in place.iterdir()} if place.is_dir() else set()
            wanted = (
                scene.file(row, step, view, modality).name
                for row in samples[scene.building]
                for step in (0, 1)
            )
            found[modality] += sum(name in names for name in wanted)
    return {modality: count for modality, count in sorted(found.items()) if count}


def _resolutions(
    scenes: list[SceneFolder], counts: dict[str, dict[str, int]]
) -> dict[str, list[str]]:
    """Sizes of the images by view; none where the view has no images."""
    return {
        view: list(
            dict.fromkeys(
                f"{scene.cameras[view].width}x{scene.cameras[view].height}" for scene in scenes
            )
        )
        if counts[view]
        else []
        for view in MODALITIES
    }


def _environment(scene: SceneFolder) -> str:
    """What tells the scene's file from others."""
    said = scene.facts.get("inputs", {}).get("scene", {})
    return str(said.get("sha256") or said.get("file") or scene.building)


def _drones(scene: SceneFolder) -> list[str]:
    inputs = scene.facts.get("inputs", {})
    named = [of.get("file") for of in (inputs.get("drone", {}), *inputs.get("more_drones", []))]
    return [Path(str(file)).stem if file else str(scene.facts["drone"]) for file in named]


def _licences(scenes: list[SceneFolder]) -> list[str]:
    known = [scene.facts.get("inputs", {}).get("licences", {}) for scene in scenes]
    return sorted({of["spdx"] for several in known for of in several.values() if of.get("spdx")})
