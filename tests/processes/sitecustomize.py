# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Processes that tests start compile Newton's kernels as the tests do, and so share them."""

import warp as wp

wp.config.enable_backward = False
