# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a Newton model says, read once on the host: trees, welds, tendons, actuators, limits."""
