/** A driver of a capsule: an entry of `drivers`. */
export interface Driver {
  name: string;
  description: string;
  /** "scripted": a function of the observation that was not trained. */
  kind: "law" | "policy" | "recording" | "scripted";
  /** The group on the leaderboard; "Added" for an added one. */
  group: string;
  /** What it senses, and what it knows of the plant; not of an added one. */
  senses?: string;
  told?: string;
  /** One of `tasks`. */
  task: string;
  /** Control law inside the step; one of `controllers`. */
  controller: string;
  /** Seed of a policy's training run. */
  seed?: number;
  /** Frozen sets of a recorded driver, which drives only on their plants. */
  recorded?: string[];
  /** Length of a step, s. */
  controlDt: number;
  /** Steps of a whole episode. */
  steps: number;
}

/** Mass of the platform in kg, and its friction coefficient. */
export interface Plant {
  M: number;
  mu: number;
}

/** A jump of the plant before the first step at or after t, s. */
export interface Change extends Plant {
  t: number;
}

/** rad, rad/s, m, m/s. */
export interface State {
  theta: number;
  theta_dot: number;
  x: number;
  x_dot: number;
}

/**
 * Fields of `capsule_gym.Disturbances`; a pair is a range from which each episode draws. Omitted
 * fields are ideal.
 */
export interface Disturbances {
  controls?: "both" | "law" | "agent";
  unmeasured?: ("theta" | "theta_dot" | "x_dot")[];
  /** m/s. */
  stick_threshold?: number;
  /** Noise of a sensor of x, m; null for none. */
  x_noise?: number | null;
  [name: string]: number | [number, number] | string | string[] | null | undefined;
}

/**
 * Options of an environment by the names of the core; null for one that is not given.
 * `core_options` of `capsule_gym.envs.contract` returns them in Python. What follows from
 * controller and task has no effect.
 */
export type Options = Record<string, number | null>;

/** What follows from the options of an environment. */
export interface Description {
  /** The settings of the step, SI units. */
  settings: Record<string, number>;
  /** The first rows of the parts of `world` behind the `quantities`, and sizes. */
  layout: Record<string, number>;
  /** The entries of the observation in order: name, lowest and highest value. */
  entries: [string, number, number][];
  /**
   * What an episode draws: row of `world`, stream, place in the stream, low, range, and
   * distribution.
   */
  draws: [number, number, number, number, number, number][];
}

/** Initial conditions of an episode; omitted values are drawn or nominal. */
export interface Start extends Partial<Plant>, Partial<State> {
  changes?: Change[];
  /** Seed of all drawn values, a whole number. */
  seed?: number;
  /** Disturbed plants only: the other constants, by the names in `constants.limits`. */
  capsule?: Record<string, number>;
  /** Disturbed plants only: values that replace drawn disturbances. */
  disturbances?: Record<string, number>;
  /** Task "goal": displacement of the goal from the start, m. */
  goal?: number;
  /** Task "velocity": times t in s and velocities v in m/s. */
  commands?: { t: number; v: number }[];
}

/** A plant of a frozen set, with its start and its jumps. */
export interface Frozen {
  set: string;
  /** Number of the plant, from 0. */
  plant: number;
  /** Replaces the plant's own jumps. */
  changes?: Change[];
}

/** Further options of `drive`. */
export interface Told {
  /** Only for an episode that draws values. A frozen plant's default is its own seed. */
  seed?: number;
  /** Not accepted with a set, which defines them. */
  disturbances?: "none" | "real" | Disturbances;
}

/** A plant of a frozen set. */
export interface FrozenPlant extends Plant {
  seed: number;
  theta?: number;
  changes?: Change[];
  goal?: number;
  capsule?: Record<string, number>;
}

/**
 * All quantities of the last step and of the episode, by the names in `quantities`, and values of
 * the task; SI units. A disturbed plant adds the sensor readings and the values that the episode
 * has drawn.
 */
export type Info = {
  [quantity: string]: number | string | Record<string, number> | undefined;
  reading?: Record<string, number>;
  capsule?: Record<string, number>;
  disturbances?: Record<string, number>;
  termination: "none" | "pendulum" | "contact" | "diverged";
};

/** The numbers of `capsule_gym.tasks.task.METRICS`. */
export interface Metrics {
  /** cm/s. */
  mean_speed: number;
  cost_of_transport: number;
  /** N m. */
  peak_torque: number;
  /** N m. */
  rms_torque: number;
  backward_ratio: number;
  stuck_fraction: number;
  smallest_normal_ratio: number;
  /** rad. */
  largest_theta: number;
  /** rad/s. */
  largest_theta_dot: number;
  /** m. */
  distance: number;
  /** J. */
  energy: number;
  /** s. */
  duration: number;
  /** 1 if the episode has failed, else 0. */
  failed: number;
  /** Task "goal": 1 if the goal was reached, else 0. */
  success?: number;
  /** Task "goal": time at which the goal was reached, s. */
  goal_time?: number;
  /** Task "velocity": error in percent of the commanded distance. */
  velocity_error?: number;
  /** Task "velocity": share of commands that were not settled. */
  unsettled?: number;
}

export interface StepResult {
  observation: Float32Array;
  reward: number;
  terminated: boolean;
  truncated: boolean;
  info: Info;
}

/** The whole state of a capsule and its driver. */
export interface Snapshot {
  readonly world: Float64Array;
  readonly observation: Float32Array;
}

export const drivers: readonly Driver[];
export const controllers: readonly string[];
export const tasks: readonly string[];
export const quantities: readonly string[];
export const sets: Readonly<Record<string, { hash: string; task: string; plants: FrozenPlant[] }>>;
export const constants: {
  control_dt: number;
  steps: number;
  /** Length of an episode by task, s. */
  horizons: Record<string, number>;
  torque_limit: number;
  theta_limit: number;
  m: number;
  l: number;
  g: number;
  nominal: Plant & Record<string, number>;
  /** Ranges from which environments draw M and mu. */
  ranges: Record<string, { M: [number, number]; mu: [number, number] }>;
  /**
   * Accepted ranges: M and mu in `reset` and `setPlant`; a disturbed plant's other constants in
   * `reset`. In SI units: `M` 0.2 to 2, `mu` 0 to 1, `m` 0.1 to 0.18, `l` 0.25 to 0.35, `g` 1
   * to 15, `k` 0.2 to 0.6, `c` 0.05 to 0.15, `static_ratio` 1 to 1.5, `backward_ratio` 0.5 to 1.5,
   * `viscous` 0 to 2, `stribeck_speed` 0.02 to 1, `slope` -0.2 to 0.2, `motor_friction` 0 to 0.2.
   */
  limits: { M: [number, number]; mu: [number, number] } & Record<string, [number, number]>;
  /** The disturbances that "real" selects. */
  real: Disturbances;
  start: State;
  largest_state: State;
};

/** One capsule, with or without a control law inside its step. */
export class Capsule {
  private constructor();
  readonly task: string;
  /** Whether an episode draws values and accepts a seed. */
  readonly draws: boolean;
  readonly controlDt: number;
  readonly horizon: number;
  readonly state: State;
  readonly observation: Float32Array;
  readonly info: Info;
  readonly metrics: Metrics;
  readonly description: Description;
  /**
   * The `quantities`, the law's memory, its row of the reference table, the task's memory, and the
   * history.
   */
  readonly world: Float64Array;
  /**
   * What `check` compares: the rows of `info`, the memories of law and task, the last reading, and
   * the observation.
   */
  readonly compared: (Float64Array | Float32Array)[];
  reset(start?: Start): { observation: Float32Array; info: Info };
  step(action: number): StepResult;
  setPlant(plant: Plant): void;
  snapshot(): Snapshot;
  restore(snapshot: Snapshot): void;
}

/** A capsule and its driver in closed loop. */
export class Episode extends Capsule {
  readonly driver: string;
  readonly action: number;
  /** The outputs h of the driver's recurrent cell, from -1 to 1; empty without one. */
  readonly memory: Float64Array;
  reset(start?: (Start | Frozen) & Pick<Told, "seed">): { observation: Float32Array; info: Info };
  /** Calls `step` with an action of the driver. */
  tick(): StepResult;
}

export function load(
  controller: string,
  options?:
    | { task?: string; disturbances?: "none" | "real" | Disturbances; options?: Options }
    | { set: string },
): Promise<Capsule>;
export function drive(driver: string, options?: (Start | Frozen) & Told): Promise<Episode>;
/** A trained policy of your own: the result of `web.data.describe_policy` in Python as JSON. */
export interface OwnDriver {
  /** Must differ from the names of other drivers. */
  name: string;
  description: string;
  kind: "policy";
  /** One of `tasks`. */
  task: string;
  /** One of `controllers`. */
  controller: string;
  seed?: number;
  options: Options;
  /** The network as the core takes it. */
  network: number[];
}

/** Adds a policy of your own to `drivers`. */
export function addDriver(driver: OwnDriver): void;
export function check(
  report?: (result: { name: string; equal: boolean; steps: number; doubles: number }) => void,
): Promise<boolean>;
