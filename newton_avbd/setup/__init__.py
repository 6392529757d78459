# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""What a solver makes of a model once: the arrays that kernels see, and what fills them."""
