"""What a symmetric model may be turned by unseen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dronepose import _native
from dronepose._arrays import floats

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray


class Symmetries:
    """The transforms under which a model looks the same, the identity always included.

    As in the BOP challenge (Hodan et al., "BOP Challenge 2020 on 6D Object Localization", ECCV
    Workshops 2020): discrete transforms, each combined with the steps of every continuous axis.

    Args:
        discrete: ``(S, 4, 4)`` or ``(S, 3, 3)`` float32 or float64, rigid transforms of the model
            frame, ``model_from_model``, translation in metres. The identity may be left out.
        continuous: Pairs ``(axis, offset)`` of 3 numbers each: any turn about ``axis`` through the
            point ``offset`` (metres).
        max_step: Largest step of a continuous symmetry, as a fraction of the model's diameter that
            a point on its surface moves; BOP uses 0.01 (315 turns).

    Raises:
        TypeError: An argument holds no real numbers.
        ValueError: A shape is wrong, a transform is no rigid motion, an axis is zero, or
            ``max_step`` is not above zero.

    Example:
        >>> import numpy as np
        >>> half_turn = np.diag([-1.0, -1.0, 1.0])
        >>> Symmetries(half_turn[None]).transforms.shape
        (2, 4, 4)
    """

    __slots__ = ("_arguments", "_native")

    def __init__(
        self,
        discrete: ArrayLike | None = None,
        continuous: Sequence[tuple[ArrayLike, ArrayLike]] = (),
        *,
        max_step: float = 0.01,
    ) -> None:
        if discrete is None:
            m = np.empty((0, 4, 4))
        elif np.shape(discrete)[-2:] == (3, 3):
            r = floats("discrete", discrete, "(S, 3, 3)")
            m = np.tile(np.eye(4), (len(r), 1, 1))
            m[:, :3, :3] = r
        else:
            m = floats("discrete", discrete, "(S, 4, 4)")
        if m.size and not np.array_equal(m[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (len(m), 1))):
            raise ValueError("discrete: expected the last row 0 0 0 1 in every transform")
        axes = [
            np.concatenate(
                [
                    floats(f"continuous[{k}] axis", axis, "(3,)"),
                    floats(f"continuous[{k}] offset", offset, "(3,)"),
                ]
            )
            for k, (axis, offset) in enumerate(continuous)
        ]
        if not max_step > 0:
            raise ValueError(f"max_step: expected a step above zero, got {max_step}")
        self._arguments = (m, [(a[:3], a[3:]) for a in axes], max_step)
        self._native = _native.Symmetries(
            np.ascontiguousarray(m[:, :3, :3]),
            np.ascontiguousarray(m[:, :3, 3]),
            np.ascontiguousarray(axes).reshape(-1, 6),
            float(max_step),
        )

    @classmethod
    def from_bop(cls, info: Mapping[str, Any], *, max_step: float = 0.01) -> Symmetries:
        """From an object's entry in BOP's ``models_info.json`` (translations in millimetres).

        Args:
            info: The entry, with ``symmetries_discrete`` (16 numbers each, row by row) and
                ``symmetries_continuous`` (``axis``, ``offset``); either may be absent.
            max_step: As in the class.

        Returns:
            The symmetries in metres.

        Raises:
            TypeError, ValueError: As in the class.

        Example:
            >>> axis = {"axis": [0, 0, 1], "offset": [0, 0, 0]}
            >>> len(Symmetries.from_bop({"symmetries_continuous": [axis]}))
            315
        """
        discrete = floats(
            "symmetries_discrete",
            np.reshape(info.get("symmetries_discrete", []), (-1, 4, 4)),
            "(S, 4, 4)",
        ).copy()
        discrete[:, :3, 3] *= 1e-3
        continuous = [
            (np.asarray(s["axis"]), np.asarray(s["offset"], dtype=np.float64) * 1e-3)
            for s in info.get("symmetries_continuous", [])
        ]
        return cls(discrete, continuous, max_step=max_step)

    @property
    def transforms(self) -> NDArray[np.float64]:
        """All transforms ``(S, 4, 4)`` float64, model frame, metres; the identity first.

        Example:
            >>> Symmetries().transforms.shape
            (1, 4, 4)
        """
        return self._native.transforms()

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, self._arguments

    def __len__(self) -> int:
        return len(self._native)

    def __repr__(self) -> str:
        return f"Symmetries({len(self)} transforms)"


def _again(discrete: ArrayLike, continuous: Sequence[Any], max_step: float) -> Symmetries:
    return Symmetries(discrete, continuous, max_step=max_step)


def native_symmetries(symmetries: Symmetries | ArrayLike | None) -> _native.Symmetries:
    """What the extension takes, for what users give."""
    if not isinstance(symmetries, Symmetries):
        symmetries = Symmetries(symmetries)
    return symmetries._native
