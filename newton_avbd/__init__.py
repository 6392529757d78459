from .solver import SolverAVBD
__all__ = ["SolverAVBD"]
