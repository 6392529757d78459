# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Performance over time: scenes of ``newton-avbd bench`` as ratios to a peer in the same run."""
