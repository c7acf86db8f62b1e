"""The scripted policies that are functions of the observation, and all scripted policies by name.

`pyproject.toml` registers the functions, so that `capsule_gym.evaluate` and the command
`capsule_gym.demo` know them by name.
"""

from baselines import lqr, mpc
from baselines.dynamic_programming import policy
from capsule_gym.policies.scripted import LAW_POLICIES, ScriptedPolicy

LQR = ScriptedPolicy(
    "lqr", "LQR with a gain for every phase of a limit cycle of dp-nominal", start=lqr.start
)
MPC = ScriptedPolicy(
    "mpc", "sampling MPC on the nominal plant with the values of dp-nominal", start=mpc.start
)
DP_NOMINAL = ScriptedPolicy(
    "dp-nominal",
    "dynamic programming for the nominal plant with a margin of normal force, whatever the plant",
    start=policy.start_nominal,
)
DP_ORACLE = ScriptedPolicy(
    "dp-oracle",
    "observes M and mu; dynamic programming for that plant",
    {"observe_parameters": True},
    policy.start_oracle,
    told="nominal plant, M, mu",
)

# Those of other tasks than the speed task, and of the speed task.
TASK_SCRIPTED = {name: each for name, each in LAW_POLICIES.items() if "task" in each.env_kwargs}
SCRIPTED = {name: each for name, each in LAW_POLICIES.items() if name not in TASK_SCRIPTED}
SCRIPTED |= {each.name: each for each in (LQR, MPC, DP_NOMINAL, DP_ORACLE)}
ALL_SCRIPTED = SCRIPTED | TASK_SCRIPTED
