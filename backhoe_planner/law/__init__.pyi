from .completed import CompletedLaw, CriticalRows, Wish, activation, push_factor
from .directionality import (
    LinkChain,
    Magnification,
    Reference,
    all_link_jacobians,
    link_chain,
    link_jacobian,
    link_velocities,
)
from .law import general_solution, joint_velocity, null_space_term, projector
from .null_space import TaskInverse, pseudo_inverse, resolve
from .on_path import step_on_path
from .paper_iteration import ITERATIONS, Push, paper_gains, paper_step, run_iteration
from .qp import PRICE, UNBOUNDED, Kind, QuadraticProgram, Rows, solve_program
from .shield import Shield, Shielded

__all__ = [
    "ITERATIONS",
    "PRICE",
    "UNBOUNDED",
    "CompletedLaw",
    "CriticalRows",
    "Kind",
    "LinkChain",
    "Magnification",
    "Push",
    "QuadraticProgram",
    "Reference",
    "Rows",
    "Shield",
    "Shielded",
    "TaskInverse",
    "Wish",
    "activation",
    "all_link_jacobians",
    "general_solution",
    "joint_velocity",
    "link_chain",
    "link_jacobian",
    "link_velocities",
    "null_space_term",
    "paper_gains",
    "paper_step",
    "projector",
    "pseudo_inverse",
    "push_factor",
    "resolve",
    "run_iteration",
    "solve_program",
    "step_on_path",
]
