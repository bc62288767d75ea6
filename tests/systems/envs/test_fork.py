# SPDX-License-Identifier: MIT
"""Environments in processes that are forked from one that has worked: they work, or say how they would."""

import os
import subprocess
import sys

import pytest

# Two threads of torch, which a fork does not copy: libgomp in the child would wait for the parent's.
FORKED = """
import os, signal, torch
torch.set_num_threads(2)
import pinwm_drake.threads
large = torch.ones(1 << 20)
large.log()
child = os.fork()
if not child:
    signal.alarm(20)
    os._exit(0 if float(large.log().sum()) == 0.0 and torch.get_num_threads() == 1 else 3)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), torch.get_num_threads())
"""
ENVIRONMENTS = """
import sys, gymnasium, torch
import pinwm_drake as pw
torch.set_num_threads(2)
name, options = pw.ENV_IDS["push"], eval(sys.argv[1])
env = gymnasium.make(name, **options)
env.reset(seed=0)
env.step(env.action_space.sample())
torch.ones(1 << 20).log()
several = gymnasium.vector.AsyncVectorEnv([lambda: gymnasium.make(name, **options)] * 2, context="fork")
try:
    several.reset(seed=0)
    several.step(several.action_space.sample())
    print("stepped")
except Exception as error:
    print(error)
several.close(terminate=True)
"""


def output_of(script, *arguments):
    here = {**os.environ, "OMP_NUM_THREADS": "2"}
    command = [sys.executable, "-c", script, *arguments]
    return subprocess.run(command, env=here, capture_output=True, text=True, check=True, timeout=300).stdout


def test_torch_works_in_a_fork():
    assert output_of(FORKED) == "0 2\n"


@pytest.mark.nightly
def test_environments_work_in_forks_of_a_process_that_has_stepped():
    assert output_of(ENVIRONMENTS, "{'observation': 'rgb', 'image_size': 32}") == "stepped\n"


@pytest.mark.nightly
def test_a_fork_of_a_process_that_has_rendered_is_refused():
    told = output_of(ENVIRONMENTS, "{'engine': 'hydroelastic', 'observation': 'rgb', 'image_size': 32}")
    assert 'allowed: context="spawn" or "forkserver"' in told
    assert "\n" not in told.strip()
