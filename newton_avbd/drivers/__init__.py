# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What runs the stages, and no physics: a world by a thread, or a stage by a launch."""
