# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Draws the figures of the derivation.

python docs/figures.py
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import newton
import numpy as np
import warp as wp

from newton_avbd import SolverAVBD
from newton_avbd.io.terminal import interruptible, progress, say

IMAGES = Path(__file__).parent / "images"
PARENT = {1: 3, 2: 3, 3: 7, 4: 6, 5: 6, 6: 7}
"""Parent of each body of the tree; the root is 7."""
PLACE = {7: (2.0, 2.0), 3: (1.0, 1.0), 6: (3.0, 1.0), 1: (0.5, 0.0), 2: (1.5, 0.0)}
PLACE |= {4: (2.5, 0.0), 5: (3.5, 0.0)}
LINKS = 10
RATIOS = (1.0, 10.0, 100.0, 1000.0)


def filled(order: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Blocks that the tree's matrix has in an order of its bodies, and that elimination adds."""
    at = {body: i for i, body in enumerate(order)}
    own = np.eye(len(order), dtype=bool)
    for child, parent in PARENT.items():
        own[at[child], at[parent]] = own[at[parent], at[child]] = True
    full = own.copy()
    for pivot in range(len(order)):
        later = np.flatnonzero(full[pivot] & (np.arange(len(order)) > pivot))
        full[np.ix_(later, later)] = True
    return own, full & ~own


def draw_elimination() -> None:
    """The tree, and its matrix in two orders."""
    figure, axes = plt.subplots(1, 3, figsize=(9, 3))
    for child, parent in PARENT.items():
        axes[0].plot(*zip(PLACE[child], PLACE[parent], strict=True), color="gray")
    for body, (x, y) in PLACE.items():
        axes[0].plot(x, y, "o", markersize=20, color="tab:blue")
        axes[0].text(x, y, str(body), ha="center", va="center", color="white")
    axes[0].set(xlim=(0, 4), ylim=(-0.5, 2.5), title="tree, root 7")
    axes[0].axis("off")
    orders = {"root first": [7, 3, 6, 1, 2, 4, 5], "children first": [1, 2, 3, 4, 5, 6, 7]}
    for panel, (name, order) in zip(axes[1:], orders.items(), strict=True):
        own, fill = filled(order)
        panel.imshow(np.where(own[..., None], (0.12, 0.47, 0.71), (1.0, 1.0, 1.0)))
        rows, columns = np.nonzero(fill)
        panel.plot(columns, rows, "x", color="tab:red")
        panel.set_title(f"{name}: {fill.sum()} blocks fill in")
        panel.set_xticks(range(7), order)
        panel.set_yticks(range(7), order)
    figure.tight_layout()
    figure.savefig(IMAGES / "elimination.svg", metadata={"Date": None})


def chain(ratio: float) -> newton.Model:
    """Ten rods on hinges, horizontal, that hang on the first; the last one is heavier."""
    builder = newton.ModelBuilder()
    joints = []
    for i in range(LINKS):
        mass = ratio if i == LINKS - 1 else 1.0
        inertia = wp.mat33(mass * np.diag([0.01, 0.1, 0.1]))
        link = builder.add_link(mass=mass, inertia=inertia)
        before = wp.transform((0.5 if i else 0.0, 0.0, 0.0), wp.quat_identity())
        behind = wp.transform((-0.5, 0.0, 0.0), wp.quat_identity())
        joints.append(
            builder.add_joint_revolute(
                i - 1, link, axis=(0.0, 1.0, 0.0), parent_xform=before, child_xform=behind
            )
        )
    builder.add_articulation(joints)
    model = builder.finalize(device="cpu")
    newton.eval_fk(model, model.joint_q, model.joint_qd, model)
    return model


def widest_gap(model: newton.Model, blocks: str, iterations: int) -> float:
    """How far a joint opens at most within a second [m]."""
    solver = SolverAVBD(model, blocks=blocks, iterations=iterations)
    state, widest = model.state(), 0.0
    for _ in range(240):
        solver.step(state, state, None, None, 1.0 / 240.0)
        pose = state.body_q.numpy().astype(float)
        x, z, sine, cosine = pose[:, 0], pose[:, 2], pose[:, 4], pose[:, 6]
        # half of each rod, whose turn is about y
        arm = 0.5 * np.stack([1.0 - 2.0 * sine**2, -2.0 * sine * cosine], axis=1)
        center = np.stack([x, z], axis=1)
        end = np.vstack([[0.0, 0.0], (center + arm)[:-1]])
        widest = max(widest, float(np.linalg.norm(center - arm - end, axis=1).max()))
    return widest


def draw_gaps() -> None:
    """Joint error against the mass of the chain's end."""
    figure, axis = plt.subplots(figsize=(6, 3.5))
    models = [chain(ratio) for ratio in RATIOS]
    settings = (
        ("body", 10, "body by body, at most 10 sweeps"),
        ("body", 100, "body by body, at most 100 sweeps"),
        ("articulation", 10, "one block, at most 10 sweeps"),
    )
    for blocks, iterations, name in progress(settings, len(settings), "settings"):
        gaps = [1.0e3 * widest_gap(model, blocks, iterations) for model in models]
        axis.loglog(RATIOS, gaps, "o-", label=name)
        say(f"{name} {gaps}")
    axis.set(xlabel="mass of the last link over that of the others", ylabel="widest gap [mm]")
    axis.legend(fontsize="small")
    figure.tight_layout()
    figure.savefig(IMAGES / "gaps.svg", metadata={"Date": None})


if __name__ == "__main__":
    plt.rcParams["svg.hashsalt"] = "newton-avbd"
    with interruptible() as interruption:
        draw_elimination()
        draw_gaps()
    sys.exit(interruption.status(0))
