# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""How a simulated state is judged: penetration, energy, joints, shapes that always overlap."""
