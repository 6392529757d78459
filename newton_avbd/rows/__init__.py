# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""One file a kind of constraint: its force, curvature and penalty, and what it remembers."""
