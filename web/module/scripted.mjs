// The policies of `baselines.policies` that look at the observation, with the bits of Python.
//
// A policy has `start`, its memory at the beginning of an episode, and `act`, which takes the first
// entries of the observation and the memory, and returns the action and the next memory.

import {constants, HEADER, readArray} from "./archive.mjs";
import {CORE, ROW, startCore} from "./core.mjs";
import {mergeOptions} from "./options.mjs";

const WORD = 64n;
const PCG_FACTOR = 0x2360ed051fc65da44385df649fccf645n;

/** Starts a driver's policy; null for a driver without one. */
export async function startScripted({name, regulator, lookahead, planner}) {
  if (regulator) return startRegulator(regulator);
  if (!lookahead) return null;
  const ahead = await startLookahead(lookahead);
  return planner ? startPlanner(ahead, planner) : startGreedy(ahead);
}

function clip(action) { return Math.min(1, Math.max(-1, action)); }

function argmax(scores) { return scores.indexOf(Math.max(...scores)); }

/** `baselines.lqr`. The memory is the phase, or null at the beginning. */
function startRegulator({table, scales, subphases, window}) {
  const content = readArray(table);
  const {rows: phases, columns} = table;
  const rowOf = (phase) => content.subarray(columns * phase, columns * (phase + 1));
  const everywhere = Array.from({length: phases}, (_, phase) => phase);
  const ahead = Array.from({length: 2 * window + 1}, (_, n) => phases + subphases + n - window);

  function act(z, last) {
    const near = last === null ? everywhere : ahead.map((offset) => (last + offset) % phases);
    const closeness = near.map((phase) => {
      const desired = rowOf(phase);
      const [a, b, c] = scales.map((scale, n) => (z[n] - desired[n]) / scale);
      return -(a * a + b * b + c * c);
    });
    const phase = near[argmax(closeness)];
    const [theta, theta_dot, x_dot, torque, ...gains] = rowOf(phase);
    const [a, b, c] = [theta, theta_dot, x_dot].map((desired, n) => gains[n] * (z[n] - desired));
    return [clip((torque - (a + b + c)) / constants.torque_limit), phase];
  }
  return {start: null, act};
}

/** `Transitions` and `StoredValues` of `baselines.dynamic_programming` on the nominal plant. */
async function startLookahead({options, values, axes, nodes, curvature, numbers}) {
  const {q, margin, failure, edge, stretch, least_cosine} = numbers;
  const table = readArray(values);
  const started = await startCore("speed", "direct", mergeOptions("speed", "direct", options));
  const {world} = started.view;
  const [, countS, countW] = nodes;

  /** Takes a step from a state; returns the next state, the reward in cm, and whether it fails. */
  function step([theta, theta_dot, x_dot], action) {
    Object.entries({theta, theta_dot, x_dot, x: 0, termination: 0, action}).forEach(put);
    started.core.advance(false);
    const failed = world[ROW.termination] !== 0 || world[ROW.normal_force] <= margin;
    const next = [world[ROW.theta], world[ROW.theta_dot], world[ROW.x_dot]];
    return [next, world[ROW.reward], failed];
  }

  function put([name, value]) { world[ROW[name]] = value; }

  /** The value of a state, cm. */
  function valueOf([theta, theta_dot, x_dot]) {
    const cosine = CORE.cosine(theta);
    const rate = x_dot / q;
    const y = rate / Math.max(cosine, least_cosine);
    const own = [theta, y / (stretch + Math.abs(y)), rate - cosine * theta_dot];
    const positions = own.map((coordinate, n) => {
      const [first, spacing] = axes[n];
      return Math.max(0, Math.min((coordinate - first) / spacing, nodes[n] - 1 - edge));
    });
    const [i, j, k] = positions.map(Math.floor);
    const [theta_share, s, w] = positions.map((position) => position - Math.floor(position));
    const interpolate = (node) => table[node] + w * Math.fround(table[node + 1] - table[node]);
    const between = (node) => {
      const low = interpolate(node);
      return low + s * (interpolate(node + countW) - low);
    };
    const corner = (i * countS + j) * countW + k;
    const near = between(corner);
    const linear = near + theta_share * (between(corner + countS * countW) - near);
    return linear - curvature * w * (1 - w);
  }

  const {M, mu} = constants.nominal;
  Object.entries({M, mu, active: 1}).forEach(put);
  return {step, valueOf, failure};
}

/** `dp-nominal`: the torque with the best next state. */
function startGreedy({step, valueOf, failure}) {
  function act(state) {
    const scores = HEADER.torques.map((torque) => {
      const [next, reward, failed] = step(state, torque);
      return failed ? failure : reward + valueOf(next);
    });
    return [HEADER.torques[argmax(scores)], null];
  }
  return {start: null, act};
}

/** `baselines.mpc`. The memory has the previous plan and the generator's state. */
function startPlanner({step, valueOf, failure}, {amplitudes, intervals, state, increment}) {
  const share = Array.from({length: intervals}, (_, n) => n / (intervals - 1));

  function score(observed, plan) {
    let state = observed;
    let sum = 0;
    let failed = false;
    for (const torque of plan) {
      const [next, reward, fails] = step(state, torque);
      failed ||= fails;
      state = failed ? [0, 0, 0] : next;
      sum += failed ? failure : reward;
    }
    return sum + valueOf(state);
  }

  function act(observed, {plan, random}) {
    const [ends, following] = uniform(random, 2 * amplitudes.length);
    const plans = amplitudes.map((amplitude, n) => {
      const first = ends[n];
      const last = ends[amplitudes.length + n];
      return plan.map(
        (torque, m) => clip(torque + amplitude * (first + share[m] * (last - first))));
    });
    const best = plans[argmax(plans.map((each) => score(observed, each)))];
    return [best[0], {plan: [...best.slice(1), best.at(-1)], random: following}];
  }

  /** Numbers of NumPy's PCG64 from -1 to 1, and the generator's next state. */
  function uniform(random, count) {
    const numbers = [];
    for (let n = 0; n < count; n++) {
      random = BigInt.asUintN(128, random * PCG_FACTOR + BigInt(increment));
      const folded = BigInt.asUintN(64, (random >> WORD) ^ random);
      const turn = random >> 122n;
      const word = BigInt.asUintN(64, (folded >> turn) | (folded << (WORD - turn)));
      numbers.push(-1 + 2 * (Number(word >> 11n) / 2 ** 53));
    }
    return [numbers, random];
  }
  return {start: {plan: Array(intervals).fill(0), random: BigInt(state)}, act};
}
