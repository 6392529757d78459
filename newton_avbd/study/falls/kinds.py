# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""What happens to robots that fall."""

KINDS = ("fallen", "spin5", "spin12", "spin30", "thrown")
"""What happens to a robot: it is dropped on the ground; it floats without weight while its joints
turn at up to so many rad/s against their limits; or it is thrown against a wall."""
