"""Files of tests that `make test` leaves to `make test-further`, so that it ends within some eight minutes.

Each looks at a part that quicker tests look at, too: whole programs, pages that are followed, strangers and damage in
many forms. In other files single tests of two seconds of a processor or more have the mark `further`, but for those
that are the first to look at a part. `.ci/run` has them all.
"""

from __future__ import annotations

FURTHER = {
    "fuzz/test_fuzz_hostile_files.py": "hostile files: unit/los_testbed/cli/test_unusual_files.py",
    "integration/test_campaign_members.py": "campaigns: unit/los_testbed/campaign/test_campaign_member.py",
    "integration/test_campaign_processes.py": "the cluster: integration/test_campaign_cluster.py",
    "integration/test_contributing_pages.py": "the pages of docs/extend, step by step",
    "integration/test_distribution.py": "wheels in environments of their own",
    "integration/test_documentation_code.py": "code on pages: architecture/test_documented_commands.py has commands",
    "integration/test_example_designs.py": "the examples' designs: unit/los_design",
    "integration/test_flight_code_bits.py": "flight code, bit by bit: unit/los_testbed/flight/test_flight_code.py",
    "integration/test_shipped_proofs.py": "stored proofs: unit/los_design/test_bundle.py",
    "integration/test_stage_comparison.py": "four stages: integration/test_predicted_against_measured.py",
    "published/test_static_output_feedback.py": "published gains: unit/lftkit/tuning/test_tuner.py",
    "ros/test_attacks.py": "strangers: ros/test_senders.py, unit/los_testbed/nodes",
    "ros/test_bad_link.py": "lost packets, two hosts: unit/los_testbed/nodes/test_middleware.py",
    "ros/test_clock_and_stamps.py": "the clock, stamps, missed ticks: unit/los_testbed/nodes, ros/test_recorder.py",
    "ros/test_closed_to_strangers.py": "packets that leave: unit/los_testbed/nodes/test_middleware.py",
    "ros/test_control.py": "requests: ros/test_senders.py",
    "ros/test_device_runs.py": "rigs: unit/los_testbed/rig/test_device_faults.py",
    "ros/test_faults.py": "nodes that end: ros/test_runs_with_processes.py, ros/test_hung_nodes.py",
    "ros/test_live_foxglove.py": "viewers: ros/test_live_page.py, unit/los_testbed/live/test_live_access.py",
    "ros/test_namespaces.py": "names of topics: ros/test_remaps.py",
    "ros/test_node_interfaces.py": "nodes as users see them: ros/test_telescope_in_processes.py",
    "ros/test_replay_to_nodes.py": "replay: unit/los_testbed",
    "ros/test_second_publishers.py": "strangers: ros/test_senders.py",
    "unit/lftkit/proofs/test_margin_proofs.py": "margins of a loop: unit/lftkit/proofs/test_certified_loop.py",
    "unit/lftkit/proofs/test_proof_premises.py": "forged files: unit/lftkit/proofs/test_checking.py",
    "unit/lftkit/tuning/test_sector_goals.py": "goals: unit/lftkit/tuning/test_goals.py",
    "unit/los_design/test_combined_bounds.py": "sums of bounds: unit/los_design/test_certify.py",
    "unit/los_design/test_paper_problem.py": "the paper, its pictures: unit/los_design/test_rounds.py",
    "unit/los_design/test_synthesis.py": "designs from end to end, of several orders: unit/los_design/test_rounds.py",
    "unit/titop_plant/test_nastran_decks.py": "decks of others: integration/test_nastran_to_run.py",
    "unit/titop_plant/test_nastran_deliveries.py": "runs of others: integration/test_nastran_to_run.py",
    "unit/titop_plant/test_nastran_matrices.py": "superelements of others: integration/test_nastran_to_run.py",
}
"""Files below `tests`, and what else looks at the same, or what they are."""


def is_further(nodeid: str) -> bool:
    """Whether a test is of one of these files.

    Examples
    --------
    >>> is_further("tests/ros/test_attacks.py::test_a[1]"), is_further("tests/ros/test_remaps.py::test_a")
    (True, False)
    """
    return nodeid.split("::", 1)[0].removeprefix("tests/") in FURTHER
