# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Torsional and rolling friction of a contact: a torque that stops the turn of b against a.

With the relative turn w of the step [rad] the torque on b is

    T = proj( lambda - k_twist (n.w) n - k_roll (w - (n.w) n) ),

where proj limits it by the normal force: |T_n| <= mu_torsional F_n, |T_t| <= mu_rolling F_n, both
coefficients in meters, as Newton authors them. The dual update is lambda <- T.
"""

import warp as wp

from ..data import SpinRow
from .contact import PENALTY, RELEASE_RATIO, TANGENT_RATIO


@wp.func
def limited(torque: wp.vec3, normal: wp.vec3, spin: SpinRow, f_n: float) -> wp.vec3:
    """The torque [N m] within what the normal force f_n [N] allows."""
    twist = wp.dot(normal, torque)
    roll = torque - twist * normal
    most_twist = spin.mu_twist * f_n
    most_roll = spin.mu_roll * f_n
    roll2 = wp.dot(roll, roll)
    if roll2 > most_roll * most_roll:
        roll = roll * (most_roll / wp.sqrt(roll2))
    return roll + wp.clamp(twist, -most_twist, most_twist) * normal


@wp.func
def trial_torque(spin: SpinRow, normal: wp.vec3, turn: wp.vec3) -> wp.vec3:
    """What the multiplier and the penalty ask for [N m]."""
    twist = (spin.k_twist - spin.k_roll) * wp.dot(normal, turn)
    return spin.torque - spin.k_roll * turn - twist * normal


@wp.func
def torque(spin: SpinRow, normal: wp.vec3, turn: wp.vec3, f_n: float) -> wp.vec3:
    """Torque on body b [N m] at the relative turn [rad] and the normal force f_n [N]."""
    return limited(trial_torque(spin, normal, turn), normal, spin, f_n)


@wp.func
def penalise(
    spin: SpinRow, normal: wp.vec3, inv_inertia: wp.mat33, turn: wp.vec3, f_n: float, h: float
) -> SpinRow:
    """The row with its penalties for this step, lower where it is about to give way.

    Args:
        spin: The row, with its multiplier warm-started.
        normal: Unit normal of the contact.
        inv_inertia: Sum of both bodies' inverse inertia [1/(kg m^2)].
        turn: Relative turn that the bodies would have without constraints [rad].
        f_n: Normal force that is expected [N].
        h: Time step [s].
    """
    out = spin
    about = wp.dot(normal, inv_inertia * normal)
    across = 0.5 * (wp.trace(inv_inertia) - about)
    k = PENALTY * TANGENT_RATIO / (h * h)
    out.k_twist = wp.where(spin.mu_twist > 0.0, k / about, 0.0)
    out.k_roll = wp.where(spin.mu_roll > 0.0, k / across, 0.0)
    if f_n <= 0.0:
        out.torque = wp.vec3(0.0)
    trial = trial_torque(out, normal, turn)
    twist = wp.dot(normal, trial)
    if wp.abs(twist) > spin.mu_twist * f_n:
        out.k_twist = RELEASE_RATIO * out.k_twist
    if wp.length(trial - twist * normal) > spin.mu_roll * f_n:
        out.k_roll = RELEASE_RATIO * out.k_roll
    return out


@wp.func
def curvature(spin: SpinRow, normal: wp.vec3) -> wp.mat33:
    """k J^T J of the row, the same for both bodies [N m/rad]."""
    return wp.diag(wp.vec3(spin.k_roll)) + wp.outer((spin.k_twist - spin.k_roll) * normal, normal)
