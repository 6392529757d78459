# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""A batch of ants in shards, each in a process of its own: over cores, GPUs or nodes, by Ray.

Worlds are independent, so that a shard computes the same bits as the whole batch would. Torques go
out and motions come in, a rollout at a time. Each rollout leaves a checkpoint in the object store
of its node; a shard whose process is lost starts again from its last one, and the others never
notice. Against the loss of whole nodes, fetch the checkpoints now and then.

    pip install newton-avbd[scenes,ray]
    python examples/ray/sharded_ants.py [--worlds 64] [--shards 2] [--rollouts 4] [--gpus] [--test]

``--gpus`` gives each shard a GPU instead of a core. On a cluster, after ``ray start`` on its nodes,
the same command with ``RAY_ADDRESS=auto`` spreads the shards over all of them.
"""

import argparse
import os
import signal
import time

import newton
import newton.examples
import numpy as np
import ray
import warp as wp

from newton_avbd import SolverAVBD

FRAMES = 15
"""Frames of a rollout."""
SUBSTEPS = 4
DT = 1.0 / 60.0 / SUBSTEPS
TORQUE = 20.0
"""Largest torque at a joint [N m]."""


class Shard:
    """Some worlds of the batch, and the solver that steps them."""

    def __init__(self, worlds: int, device: str):
        ant = newton.ModelBuilder()
        ant.default_shape_cfg.gap = 0.02
        ant.add_mjcf(newton.examples.get_asset("nv_ant.xml"), parse_sites=False)
        builder = newton.ModelBuilder()
        builder.replicate(ant, worlds)
        self.worlds = worlds
        self.model = builder.finalize(device=device)
        newton.eval_fk(self.model, self.model.joint_q, self.model.joint_qd, self.model)
        self.pipeline = newton.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts()
        # the shards are the workers
        self.solver = SolverAVBD(self.model, angular_friction=False, workers=1)
        self.control = self.model.control()
        self.state, self.next = self.model.state(), self.model.state()

    @ray.method(num_returns=2)
    def rollout(self, torques: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Motion of each frame, shape (frames, worlds, bodies, 13), and what to go on from.

        Args:
            torques: For each frame, shape (frames, worlds, hinges) [N m].
        """
        motion = []
        for torque in torques:
            joint_f = np.zeros((self.worlds, 6 + torque.shape[-1]), dtype=np.float32)
            joint_f[:, 6:] = torque
            self.control.joint_f.assign(joint_f.ravel())
            self.pipeline.collide(self.state, self.contacts)
            for _ in range(SUBSTEPS):
                self.solver.step(self.state, self.next, self.control, self.contacts, DT)
                self.state, self.next = self.next, self.state
            pair = self.state.body_q.numpy(), self.state.body_qd.numpy()
            motion.append(np.concatenate(pair, axis=1).reshape(self.worlds, -1, 13))
        saved = {"body_q": self.state.body_q.numpy(), "body_qd": self.state.body_qd.numpy()}
        return np.array(motion), {**saved, **self.solver.checkpoint()}

    def restore(self, checkpoint: dict[str, np.ndarray]) -> None:
        """Goes on from where a rollout ended."""
        remembered = dict(checkpoint)
        self.state.body_q.assign(remembered.pop("body_q"))
        self.state.body_qd.assign(remembered.pop("body_qd"))
        self.solver.restore(remembered)

    def process(self) -> int:
        return os.getpid()


class Batch:
    """All worlds, in as many processes as there are shards."""

    def __init__(self, worlds: int, shards: int, gpus: bool):
        self.bounds = np.linspace(0, worlds, shards + 1).astype(int)
        self.device = "cuda" if gpus else "cpu"
        self.remote = ray.remote(num_cpus=1, num_gpus=int(gpus))(Shard)
        self.restarts = 0
        self.shards = [self.start(shard) for shard in range(shards)]
        self.checkpoints: list[ray.ObjectRef | None] = [None] * shards

    def start(self, shard: int) -> ray.actor.ActorHandle:
        return self.remote.remote(int(np.diff(self.bounds)[shard]), self.device)

    def rollout(self, torques: np.ndarray) -> np.ndarray:
        """Motion of all worlds, gathered, shape (frames, worlds, bodies, 13)."""
        parts = np.split(torques, self.bounds[1:-1], axis=1)
        pending = [s.rollout.remote(part) for s, part in zip(self.shards, parts, strict=True)]
        motion = []
        for shard, part in enumerate(parts):
            while True:
                moved, checkpoint = pending[shard]
                try:
                    motion.append(ray.get(moved))
                    break
                except ray.exceptions.RayActorError:
                    self.restarts += 1
                    self.shards[shard] = self.start(shard)
                    if self.checkpoints[shard] is not None:
                        self.shards[shard].restore.remote(self.checkpoints[shard])
                    pending[shard] = self.shards[shard].rollout.remote(part)
            self.checkpoints[shard] = checkpoint
        return np.concatenate(motion, axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--shards", type=int, default=2)
    parser.add_argument("--rollouts", type=int, default=4)
    parser.add_argument("--gpus", action="store_true", help="a GPU for each shard")
    parser.add_argument(
        "--test", action="store_true", help="kill a shard, compare with one process"
    )
    args = parser.parse_args()
    ray.init(log_to_driver=False, include_dashboard=False)
    rng = np.random.default_rng(5)
    shape = (args.rollouts, FRAMES, args.worlds, 8)
    torques = list(rng.uniform(-TORQUE, TORQUE, shape).astype(np.float32))
    batch = Batch(args.worlds, args.shards, args.gpus)
    motion, times = [], []
    for i, torque in enumerate(torques):
        if args.test and i == args.rollouts // 2:
            os.kill(ray.get(batch.shards[-1].process.remote()), signal.SIGKILL)
        begin = time.perf_counter()
        motion.append(batch.rollout(torque))
        times.append(time.perf_counter() - begin)
    # the first one starts the processes
    seconds = np.median(times[1:]) / (FRAMES * SUBSTEPS * args.worlds)
    saved = sum(a.nbytes for c in ray.get(batch.checkpoints) for a in c.values())
    print(
        f"{args.worlds} worlds in {args.shards} shards: {1.0 / seconds:,.0f} world steps a second; "
        f"a rollout of {FRAMES} frames gathers {motion[0].nbytes / args.worlds:,.0f} B a world of "
        f"motion and keeps {saved / args.worlds:,.0f} B of checkpoint"
    )
    if args.test:
        alone = Shard(args.worlds, batch.device)
        for torque, moved in zip(torques, motion, strict=True):
            assert np.array_equal(alone.rollout(torque)[0], moved), "shards change the motion"
        assert batch.restarts == 1
        apart = np.ptp(motion[-1][-1], axis=0).max()
        assert apart > 0.01, "all worlds are alike"
        print("the same bits as from one process, though a shard was lost on the way")


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_WARNING
    main()
