"""Training, prediction, comparison of losses: ``dronepose train``, ``predict``, ``reproduce``.

:class:`~dronepose.train.task.PoseTask` is what is trained, :mod:`dronepose.train.report` judges it,
:mod:`dronepose.train.cli` is the command over Lightning. Needs ``pip install "dronepose[train]"``.
"""
