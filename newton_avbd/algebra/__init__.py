# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0

"""Device mathematics: rotations and the symmetric 6x6 block."""
