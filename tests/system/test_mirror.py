"""Every module has its file of tests, at the same path below tests/, or stands in a table with the file that tests it and why."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import pytest
from support import order, paths
from support.modules import read_modules

ROOT = paths.ROOT
# Why a module has no file of tests of its own -> module -> the file below tests/ that tests it.
TESTED_ELSEWHERE: dict[str, dict[str, str]] = {
    "it only names things, and who uses the names is tested": {
        "emulator.processes.process_ended": "emulator/processes/test_fork_server_client.py",
        "emulator.topology.coordinates": "emulator/topology/test_socket_directory.py",
        "host.facade.aio": "host/client/test_async_client.py",
        "host.render.renderer": "host/client/test_client.py",
        "host.client.facts": "host/service/test_service_commands.py",
        "host.service.events": "host/service/test_service.py",
        "host.service.scribe_calls": "host/service/test_service_hostile.py",
        "host.service.state": "host/service/test_service.py",
        "node.runtime.node_tables": "node/runtime/test_event_loop.py",
        "node.errors": "emulator/processes/test_array_failures.py",
        "node.geometry.surface_tables": "node/tracing/test_step.py",
        "node.protocol.counters": "node/tracing/test_step.py",
        "node.protocol.frame": "node/protocol/test_commands.py",
        "node.runtime.profile_parts": "node/runtime/test_profile.py",
        "host.cli.group_inspect": "host/cli/test_main.py",
        "host.cli.group_machine_time": "host/cli/test_main.py",
        "host.cli.group_service": "host/cli/test_main.py",
        "host.cli.group_start": "host/cli/commands/test_demo.py",
        "host.scene.formats.toml_schema": "host/scene/formats/test_toml.py",
    },
    "it is a part of a kernel, which is compared with its definition or with the oracle as a whole": {
        "emulator.partition.kernels": "emulator/partition/test_split.py",
        "emulator.simulator.kernels": "emulator/simulator/test_simulator.py",
        "emulator.simulator.work_kernels": "emulator/simulator/test_work_count.py",
        "node.runtime.profile_kernel": "node/runtime/test_profile.py",
        "node.geometry.bvh_boxes": "node/geometry/test_bvh.py",
        "node.jit.code_types": "node/tracing/test_spawn.py",
        "node.jit.lanes": "node/jit/test_formula.py",
        "node.jit.lanes_llvm": "node/jit/test_formula.py",
        "node.jit.lanes_numpy": "node/jit/test_formula.py",
        "node.protocol.decoding": "node/protocol/test_packets.py",
        "node.protocol.packing": "node/protocol/test_packets.py",
        "node.programs.hooks": "node/programs/test_programs.py",
        "node.runtime.native_links": "node/runtime/test_event_loop.py",
        "node.timed.service_clock": "node/timed/test_timed_processor.py",
        "node.tracing.batch": "node/runtime/test_event_loop.py",
        "node.tracing.camera": "node/tracing/test_primaries.py",
        "node.tracing.output_queues": "node/tracing/test_spawn.py",
        "node.tracing.secondary_rays": "node/tracing/test_step_by_hand.py",
        "node.tracing.shading": "node/tracing/test_step_by_hand.py",
        "node.tracing.single_ray": "node/tracing/test_ray_setup.py",
        "node.tracing.step_tables": "node/tracing/test_step.py",
        "node.tracing.traverse": "node/geometry/test_intersect.py",
        "emulator.simulator.event_loop": "emulator/simulator/test_simulator.py",
    },
    "it is what a neighbour of it is made of, and its rules show there": {
        "node.runtime.surface_flood": "emulator/driver/test_flood.py",
        "emulator.driver.admission": "emulator/topology/test_bounds.py",
        "emulator.driver.dealing": "emulator/driver/test_flood.py",
        "emulator.processes.early_imports": "emulator/processes/test_fork_server_client.py",
        "emulator.processes.fork_server_protocol": "emulator/processes/test_fork_server_client.py",
        "emulator.processes.node_messages": "emulator/processes/test_reset.py",
        "emulator.processes.process_watch": "emulator/processes/test_fork_server_client.py",
        "host.cli.ending": "host/cli/test_stopping.py",
        "host.client.async_connection": "host/client/test_async_client.py",
        "node.geometry.rigid_motion": "node/geometry/test_bvh_refit.py",
        "node.geometry.surfaces": "node/protocol/test_messages.py",
        "node.jit.target": "host/cli/test_doctor_facts.py",
        "node.jit.trusted_files": "node/jit/test_cache.py",
        "node.links.memory_channel": "node/links/test_link.py",
        "node.links.zmq_channel": "node/links/test_link.py",
        "node.protocol.codec": "node/protocol/test_messages.py",
        "node.protocol.frame_tables": "node/protocol/test_commands.py",
        "node.protocol.reset": "node/links/test_control_channel.py",
        "node.remarks": "node/jit/test_cache.py",
        "node.runtime.native_link_table": "node/runtime/test_event_loop.py",
        "node.runtime.node_state": "emulator/driver/test_memory_array.py",
        "node.runtime.processor": "node/runtime/test_event_loop.py",
        "node.runtime.reduction_replies": "node/runtime/test_reduction.py",
        "node.runtime.report": "host/render/test_stats.py",
        "node.runtime.self_test": "node/programs/test_programs.py",
        "node.timed.lookahead": "node/timed/test_timed_processor.py",
        "node.tracing.local_geometry": "node/geometry/test_bvh_refit.py",
        "emulator.analysis.sample_facts": "emulator/analysis/test_provenance.py",
        "emulator.analysis.single_step": "emulator/analysis/test_deadlock_model.py",
        "emulator.driver.driver": "emulator/driver/test_memory_array.py",
        "emulator.driver.increments": "node/runtime/test_increments.py",
        "emulator.driver.samples": "node/runtime/test_probe.py",
        "emulator.partition.cost_grid": "emulator/partition/test_split.py",
        "emulator.partition.sampling_prepass": "emulator/partition/test_split.py",
        "emulator.processes.compile_clock": "emulator/processes/test_kernel_kinds.py",
        "emulator.processes.control": "emulator/processes/test_fork_server_client.py",
        "emulator.processes.stderr_log": "emulator/processes/test_fork_server_client.py",
        "emulator.processes.warm": "emulator/processes/test_kernel_kinds.py",
        "emulator.simulator.flood_time": "emulator/simulator/test_simulator.py",
        "emulator.simulator.sample_order": "emulator/simulator/test_simulator.py",
        "emulator.simulator.shared_tables": "emulator/simulator/test_simulator.py",
        "emulator.topology.topology": "emulator/processes/test_array.py",
        "host.client.service_files": "host/client/test_connection.py",
        "host.export.povray_surfaces": "host/export/test_povray.py",
        "host.export.scene_file": "host/export/test_gltf_file.py",
        "host.export.tessellation": "host/export/test_gltf_file.py",
        "host.scene.formats.polygon_mesh": "host/scene/formats/test_memory_scene.py",
        "host.scene.formats.toml_writer": "host/scene/formats/test_memory_scene.py",
        "host.files.regular_file": "host/scene/test_file_access.py",
        "host.files.state_home": "host/files/test_input_guard.py",
        "host.files.toml_reader": "host/scene/formats/test_toml.py",
        "host.image.moving_pictures": "host/cli/commands/test_frames.py",
        "host.image.outputs": "host/files/test_part_files.py",
        "host.image.resume_check": "host/image/test_frames.py",
        "host.journal.facts": "host/service/test_service_commands.py",
        "host.journal.repair": "host/journal/test_journal.py",
        "host.machine_time.scaling_law_report": "host/machine_time/test_scaling_law.py",
        "host.machine_time.law_rivals_report": "host/machine_time/test_law_rivals.py",
        "host.machine_time.simulate": "emulator/simulator/test_simulator.py",
        "host.machine_time.simulate_stats": "emulator/simulator/test_simulator.py",
        "host.probes.chrome_trace": "node/runtime/test_probe.py",
        "host.probes.probing": "node/runtime/test_probe.py",
        "host.probes.prometheus": "host/probes/test_metrics_server.py",
        "host.probes.record": "node/runtime/test_probe.py",
        "host.probes.sums": "node/runtime/test_probe.py",
        "host.render.animation_jobs": "host/scene/animation/test_animation.py",
        "host.render.frame": "emulator/processes/test_array.py",
        "host.render.import_block": "node/jit/test_fast_load.py",
        "host.render.job": "emulator/partition/test_split.py",
        "host.client.submission": "host/client/test_requests.py",
        "host.render.given_settings": "host/render/test_api.py",
        "host.render.machine_job": "emulator/partition/test_split.py",
        "host.render.prepared": "host/cli/commands/test_frames.py",
        "host.render.program_file": "node/programs/test_programs.py",
        "host.scene.animation.motions": "host/scene/animation/test_animation.py",
        "host.scene.animation.scene_frames": "host/scene/animation/test_animation.py",
        "host.scene.animation.turntable": "host/scene/animation/test_animation.py",
        "host.scene.builder": "host/scene/test_scene.py",
        "host.scene.finish": "host/scene/test_scene.py",
        "host.scene.formats.gltf_document": "host/scene/formats/test_gltf.py",
        "host.scene.formats.gltf_materials": "host/scene/formats/test_gltf.py",
        "host.scene.formats.mtl": "host/scene/formats/test_meshes.py",
        "host.scene.formats.nff_words": "host/scene/formats/test_nff.py",
        "host.scene.formats.obj": "host/scene/formats/test_meshes.py",
        "host.scene.formats.toml_animation": "host/scene/animation/test_animation.py",
        "host.scene.formats.toml_errors": "host/scene/formats/test_toml.py",
        "host.scene.lights": "host/scene/test_scene.py",
        "host.scene.load": "host/scene/test_file_access.py",
        "host.scene.pose": "host/scene/animation/test_animation.py",
        "host.scene.textures": "host/scene/formats/test_meshes.py",
        "host.scene.transform": "host/scene/formats/test_toml.py",
        "host.service.answers": "host/service/test_service_commands.py",
        "host.service.array_supervisor": "host/service/test_service_faults.py",
        "host.service.job_facts": "host/service/test_jobs.py",
        "host.service.job_files": "host/service/test_service_films.py",
        "host.service.node_samples": "host/service/test_service_commands.py",
        "host.service.pickled_calls": "host/service/test_service_hostile.py",
        "host.service.scene_store": "host/service/test_service_animations.py",
        "host.service.scribe": "host/service/test_service_hostile.py",
        "host.service.worker": "host/service/test_service_hostile.py",
        "host.text.error_text": "host/text/test_clean_text.py",
        "host.text.standard_streams": "host/cli/test_surroundings.py",
        "host.text.tables": "host/cli/test_probe_view.py",
    },
    "it is the main of a process, which is tested by what the process does": {
        "node.main": "emulator/processes/test_array.py",
        "emulator.processes.control_channels": "node/links/test_control_channel.py",
        "emulator.processes.fork_server": "emulator/processes/test_fork_server_client.py",
        "emulator.processes.node_processes": "emulator/processes/test_reset.py",
        "emulator.topology.wiring": "emulator/processes/test_reset.py",
        "host.facade.__main__": "host/cli/test_entry.py",
        "host.service.process": "host/service/test_service.py",
        "host.service.scribe_process": "host/service/test_service_hostile.py",
    },
    "it is a command or what commands print, and is tested as it is typed": {
        "host.cli.commands.array": "host/service/test_service_commands.py",
        "host.cli.commands.jam": "emulator/analysis/test_deadlock_model.py",
        "host.cli.commands.law": "host/machine_time/test_scaling_law.py",
        "host.cli.commands.list": "host/service/test_service_commands.py",
        "host.cli.commands.load": "node/programs/test_programs.py",
        "host.cli.commands.predict": "host/machine_time/test_predict.py",
        "host.cli.commands.probe": "host/cli/test_probe_view.py",
        "host.cli.commands.render_request": "host/cli/test_bad_input.py",
        "host.cli.commands.simulate": "emulator/simulator/test_simulator.py",
        "host.cli.commands.submit": "host/service/test_service_films.py",
        "host.cli.commands.trace": "emulator/analysis/test_provenance.py",
        "host.cli.probe_table": "host/cli/test_probe_view.py",
        "host.cli.profile_table": "node/runtime/test_profile.py",
        "host.cli.progress": "host/cli/commands/test_frames.py",
        "host.cli.trace": "emulator/analysis/test_provenance.py",
        "host.cli.types": "host/text/test_misuse.py",
    },
}

Listed = Mapping[str, Mapping[str, str]]


def own_test(name: str) -> str:
    """Where the tests of a module belong, below tests/."""
    *rooms, module = name.split(".")
    return "/".join([*rooms, f"test_{module}.py"])


def untested(names: Collection[str], tests: Collection[str], listed: Listed) -> list[str]:
    """Modules with neither a file of tests nor a line in the table."""
    known = {name for group in listed.values() for name in group}
    return sorted(f"{name} has no tests/{own_test(name)}" for name in set(names) - known if own_test(name) not in tests)


def stale(names: Collection[str], tests: Collection[str], listed: Listed) -> list[str]:
    """Lines of the table that are no longer so."""
    faults = []
    for group in listed.values():
        for name, test in group.items():
            if name not in names:
                faults.append(f"{name} is listed, and not there")
            elif own_test(name) in tests:
                faults.append(f"{name} is listed, and has tests/{own_test(name)}")
            elif test not in tests:
                faults.append(f"{name} is listed with tests/{test}, which is not there")
    return faults


def strays(names: Collection[str], tests: Collection[str]) -> list[str]:
    """Files of tests in rooms that are none; those of no one module lie in the room that they test, or in tests/system."""
    rooms = {"/".join(name.split(".")[:-1]) for name in names} | {"system", "oracle"}
    return [f"tests/{test} lies in no room" for test in sorted(tests) if test.rpartition("/")[0] not in rooms]


def files_below(tests: Path) -> set[str]:
    return {str(path.relative_to(tests)) for path in tests.rglob("test_*.py")}


NAMES = [name for name, module in read_modules(ROOT).items() if not module.is_package]
TESTS = files_below(ROOT / "tests")


def test_every_module_has_its_tests():
    assert len(NAMES) > 200
    assert untested(NAMES, TESTS, TESTED_ELSEWHERE) == []


def test_the_table_is_no_longer_than_it_must_be():
    assert stale(NAMES, TESTS, TESTED_ELSEWHERE) == []
    listed = [name for group in TESTED_ELSEWHERE.values() for name in group]
    assert len(listed) == len(set(listed))


def test_tests_lie_in_the_rooms_that_they_test():
    assert strays(NAMES, TESTS) == []


def test_the_order_of_tests_names_files_that_are_there():
    assert set(order.FIRST) <= {Path(test).stem for test in TESTS}


@pytest.fixture
def small(tmp_path):
    """Two modules, the first of which has its tests, and tests in a room that there is not."""
    for name in (
        "node/jit/cache.py",
        "node/jit/lanes.py",
        "tests/node/jit/test_cache.py",
        "tests/node/attic/test_old.py",
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    return list(read_modules(tmp_path)), files_below(tmp_path / "tests")


def test_each_check_sees_what_is_wrong(small):
    names, tests = small
    assert untested(names, tests, {}) == ["node.jit.lanes has no tests/node/jit/test_lanes.py"]
    listed = {"reason": {"node.jit.lanes": "node/jit/test_cache.py"}}
    assert untested(names, tests, listed) == stale(names, tests, listed) == []
    wrong = {
        "node.jit.cache": "system/test_a.py",
        "node.jit.lanes": "system/test_a.py",
        "node.sieve": "system/test_a.py",
    }
    assert stale(names, tests, {"reason": wrong}) == [
        "node.jit.cache is listed, and has tests/node/jit/test_cache.py",
        "node.jit.lanes is listed with tests/system/test_a.py, which is not there",
        "node.sieve is listed, and not there",
    ]
    assert strays(names, tests) == ["tests/node/attic/test_old.py lies in no room"]
