"""Tries a program before it is used: in a world of its own, with every kind of ray, in the node that got it."""

from __future__ import annotations

import numpy as np

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.lattice import LATTICE, make_space
from raygrid.node.geometry.surfaces import OWN_HALF, OWN_NUMBERS, STORED_AS, STRIDE, AddedKind, Batch, Kind
from raygrid.node.programs.programs import Compiled, Program, compiled, read_program, try_functions
from raygrid.node.protocol.commands import CommandMap
from raygrid.node.protocol.frame_tables import LIGHT_COLUMNS, MATERIAL_COLUMNS, RULE, RULE_COLUMNS, Frame
from raygrid.node.runtime.node_state import NodeState

MOST_BATCHES = 10_000


def ready_program(order: CommandMap, allowed: bool) -> Compiled | None:
    """The program of an order, compiled and tried; None for none. Raises ProtocolError, also if it is not allowed."""
    program = read_program(order)
    if program is None:
        return None
    if not allowed:
        raise ProtocolError(f"the program {program.name} came, and this array was launched without --allow-programs")
    try_functions(program)
    return compiled(program, attempt)


def attempt(made: Compiled) -> None:
    """Trace a small picture of a programmed surface, a triangle, and the background. Raises what the program raises."""
    node_state = NodeState((0, 0, 0), (1, 1, 1))
    node_state.ready = made
    node_state.use_ready()
    node_state.set_space(make_space((2.0**-24,) * 3, [[0, LATTICE]] * 3))
    for batch in _surfaces(made.program):
        node_state.retain(batch, batch.bounds())
    node_state.build()
    node_state.set_frame(tiny_frame(rule=True))
    node_state.quota = 64
    for _ in range(MOST_BATCHES):
        if not node_state.has_work:
            return
        node_state.work()
    raise ProtocolError(f"the program {made.program.name} has not traced 64 rays after {MOST_BATCHES} batches")


def _surfaces(program: Program) -> list[Batch]:
    flat = np.array([[-0.4, -0.4, -0.3, 0.4, -0.4, -0.3, 0.0, 0.4, -0.3]], STORED_AS[Kind.TRIANGLE])
    batches = [Batch(Kind.TRIANGLE, np.array([1], np.uint32), np.zeros(1, np.uint16), flat)]
    if "surface_hits" in program.hooks:
        kind = AddedKind.PROGRAMMED
        row = np.zeros((1, STRIDE[kind]))
        row[0, :5], row[0, OWN_HALF:OWN_NUMBERS], row[0, OWN_NUMBERS:] = (1.0, 0.0, 0.0, 0.0, 0.25), 1.0, 0.5
        batches.append(Batch(kind, np.zeros(1, np.uint32), np.zeros(1, np.uint16), row))
    return batches


def tiny_frame(rule: bool = False) -> Frame:
    """A small frame with lights of both kinds, for calling every kernel; `rule`: its material has one of a program."""
    rows = ((0.0, 0.0, 2.0), (0.0,) * 3, (0.0,) * 3, (-0.2, 0.2, -1.0), (0.05, 0.0, 0.0), (0.0, -0.05, 0.0))
    materials, lights = np.full((1, MATERIAL_COLUMNS + RULE_COLUMNS * rule), 0.5), np.zeros((2, LIGHT_COLUMNS))
    materials[0, RULE : RULE + 1] = 1.0  # where it has one
    lights[0, :7], lights[1, :7] = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0), (1.0, 0.3, 0.3, 0.6, 1.0, 1.0, 1.0)
    return Frame(np.array(rows), materials, lights, 2, (0.1, 0.1, 0.1), 8, 8, 1, 3, 0.0, False)
