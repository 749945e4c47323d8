"""Gives all commands what they have in common: variables of the environment for defaults, and the exit codes in their help."""

from __future__ import annotations

import click

# option -> variable that has its default
VARIABLES = {
    "--array": "RAYGRID_ARRAY",
    "--name": "RAYGRID_NAME",
    "--size": "RAYGRID_SIZE",
    "--samples": "RAYGRID_SAMPLES",
    "--depth": "RAYGRID_DEPTH",
    "--min-weight": "RAYGRID_MIN_WEIGHT",
    "--split": "RAYGRID_SPLIT",
    "--batch": "RAYGRID_BATCH",
    "--budget": "RAYGRID_BUDGET",
    "--transfer": "RAYGRID_TRANSFER",
    "--patience": "RAYGRID_PATIENCE",
    "--attempts": "RAYGRID_ATTEMPTS",
    "--cost": "RAYGRID_COST",
    "--quiet": "RAYGRID_QUIET",
}
# Options of these names that mean something else, or whose default is part of an experiment.
WITHOUT = {
    ("jam", "--budget"),
    ("jam", "--size"),
    ("law", "--size"),
    ("law", "--split"),
    ("render", "--cost"),  # is refused without --timed
}
EXIT_CODES = {"done": 0, "failed": 1, "misuse": 2, "stopped by Ctrl-C": 130}
FAILED = {  # what else ends with 1
    "submit": "a job that failed or was cancelled",
    "wait": "a job that failed or was cancelled",
    "cancel": "jobs that had all ended already",
    "doctor": "something would stop a small array; it is said what helps",
    "load": "a program that the nodes refuse",
    "law": "too few points for a fit",
}


def apply_conventions(group: click.Group) -> None:
    """Let options of all commands take their defaults from variables, and every help end with the exit codes."""
    group.epilog = f"{group.epilog or ''}\n{_exit_codes('')}"
    for name, command in group.commands.items():
        command.epilog = f"{command.epilog or ''}\n{_exit_codes(name)}"
        for option in command.params:
            for spelling in option.opts:
                if isinstance(option, click.Option) and spelling in VARIABLES and (name, spelling) not in WITHOUT:
                    option.envvar, option.show_envvar = VARIABLES[spelling], True


def _exit_codes(command: str) -> str:
    codes = ", ".join(f"{code} {what}" for what, code in EXIT_CODES.items())
    also = f"\n1 also: {FAILED[command]}." if command in FAILED else ""
    return f"\n\b\nExit codes: {codes}.{also}\n"


def source_of(error: click.BadParameter) -> str:
    """Where the value of an option came from, in brackets, if not from the command line."""
    context, parameter = error.ctx, error.param
    if context is None or parameter is None or parameter.name is None or not isinstance(parameter.envvar, str):
        return ""
    came = context.get_parameter_source(parameter.name)
    return f" (from the variable {parameter.envvar})" if came is click.core.ParameterSource.ENVIRONMENT else ""
