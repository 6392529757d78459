# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
import newton
import numpy as np
import warp as wp
from newton.solvers import SolverBase

from . import data
from .algebra.block import BlockFactor
from .effects import Effects
from .execute.bodies import make_integrate, make_predict
from .execute.world import make_solve


class SolverAVBD(SolverBase):
    def __init__(self, model, *, iterations=10):
        super().__init__(model)
        self.iterations = iterations
        self.effects = Effects(True, True, False, False, True, False)
        m = model
        nb = m.body_count
        bm = data.BodyModel()
        bm.mass = m.body_mass
        bm.inertia = m.body_inertia
        bm.inv_mass = m.body_inv_mass
        bm.inv_inertia = m.body_inv_inertia
        bm.com = m.body_com
        bm.flags = m.body_flags
        bm.world = m.body_world
        bm.gravity = m.gravity
        self.bm = bm
        sm = data.ShapeModel()
        sm.body = m.shape_body
        sm.mu = m.shape_material_mu
        self.sm = sm
        w = data.BodyWork()
        n = nb + 1
        w.com = wp.zeros(n, dtype=wp.vec3)
        w.inv_mass = wp.zeros(n, dtype=float)
        w.inertia = wp.zeros(n, dtype=wp.mat33)
        w.inv_inertia = wp.zeros(n, dtype=wp.mat33)
        w.target = wp.zeros(n, dtype=wp.spatial_vector)
        w.increment = wp.zeros(n, dtype=wp.spatial_vector)
        w.spin_gain = wp.zeros(n, dtype=wp.vec3)
        w.finite = wp.zeros(n, dtype=wp.int32)
        w.factor = wp.zeros(n, dtype=BlockFactor)
        self.work = w
        ww = data.WorldWork()
        ww.body_start = wp.array([0, nb], dtype=wp.int32)
        ww.bodies = wp.array(np.arange(nb), dtype=wp.int32)
        self.worlds = ww
        self.cap = 0
        self.history = data.History()
        self.history.falling = wp.zeros(n, dtype=float)
        self.history.parity = wp.zeros(1, dtype=wp.int32)
        self.history.start = wp.zeros((2, n), dtype=wp.int32)
        self.history.end = wp.zeros((2, n), dtype=wp.int32)
        r = data.RowWork()
        for name in ("owned_start", "owned_end", "other_start", "other_end"):
            setattr(r, name, wp.zeros(n, dtype=wp.int32))
        self.rows = r

    def grow(self, c):
        cap = c.rigid_contact_max
        self.cap = cap
        self.rows.rows = wp.zeros(cap, dtype=data.ContactRow)
        self.rows.contact = wp.zeros(cap, dtype=wp.int32)
        self.rows.other_rows = wp.zeros(cap, dtype=wp.int32)
        self.history.records = wp.zeros((2, cap), dtype=data.ContactRecord)
        self.worlds.contacts = wp.array(np.arange(cap), dtype=wp.int32)
        self.worlds.contact_start = wp.zeros(2, dtype=wp.int32)
        ci = data.ContactInput()
        ci.count = c.rigid_contact_count
        ci.capacity = cap
        ci.shape0 = c.rigid_contact_shape0
        ci.shape1 = c.rigid_contact_shape1
        ci.point0 = c.rigid_contact_point0
        ci.point1 = c.rigid_contact_point1
        ci.normal = c.rigid_contact_normal
        ci.margin0 = c.rigid_contact_margin0
        ci.margin1 = c.rigid_contact_margin1
        self.ci = ci

    def step(self, state_in, state_out, control, contacts, dt, *, observables=None):
        nb = self.model.body_count
        if contacts is None:
            wp.launch(make_integrate(self.effects), nb, inputs=[self.bm, state_in.body_q, state_in.body_qd, state_in.body_f, dt], outputs=[state_out.body_q, state_out.body_qd])
            return
        if contacts.rigid_contact_max > self.cap:
            self.grow(contacts)
        wp.launch(make_predict(self.effects), nb, inputs=[self.bm, state_in.body_q, state_in.body_qd, state_in.body_f, dt, self.history, self.work])
        wp.copy(self.worlds.contact_start, contacts.rigid_contact_count, 1, 0, 1)
        wp.launch(make_solve(self.effects), 1, inputs=[self.bm, self.sm, state_in.body_q, state_in.body_qd, self.ci, dt, self.iterations, self.worlds, self.work, self.rows, self.history], outputs=[state_out.body_q, state_out.body_qd])
