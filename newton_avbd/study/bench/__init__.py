# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Time, quality, growth and memory, beside Newton's solvers and MuJoCo."""
