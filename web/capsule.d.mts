/** What drives a capsule, as `drivers` lists it. */
export interface Driver {
  name: string;
  description: string;
  kind: "law" | "gait" | "policy" | "recording" | "none";
  /** One of `tasks`. */
  task: string;
  /** Which law lies inside the step; one of `controllers`. */
  controller: string;
  /** Seed of a policy's training run. */
  seed?: number;
  /** Energy weights that a policy can be told, cm/J. */
  energyWeight?: [number, number];
  /** Where what it does is recorded: the frozen sets on whose plants alone it drives. */
  recorded?: string[];
  /** How many seeds it takes, where it draws random torques. */
  seeds?: number;
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

/** Fields of `capsule_gym.Disturbances`; a pair is a range that each episode draws from. What is left out is ideal. */
export interface Disturbances {
  controls?: "both" | "law" | "agent";
  unmeasured?: ("theta" | "theta_dot" | "x_dot")[];
  /** m/s. */
  stick_threshold?: number;
  [name: string]: number | [number, number] | string | string[] | undefined;
}

/** How an episode begins; what is left out is drawn, or nominal. */
export interface Start extends Partial<Plant>, Partial<State> {
  changes?: Change[];
  /** A whole number, which what is drawn follows from. */
  seed?: number;
  /** Of a disturbed plant: its other constants by the names in `constants.limits`, and what its episode would draw. */
  capsule?: Record<string, number>;
  disturbances?: Record<string, number>;
  /** Of the task "goal": its displacement from the start, m. */
  goal?: number;
  /** Of the task "velocity": in s and m/s. */
  commands?: { t: number; v: number }[];
}

/** A plant of a frozen set, with its start and its jumps. */
export interface Frozen {
  set: string;
  /** From 0. */
  plant: number;
  /** In place of its jumps. */
  changes?: Change[];
}

/** What a driver is told besides. */
export interface Told {
  /** cm/J. */
  energyWeight?: number;
  /** Where something is drawn; that of a frozen plant is its own. */
  seed?: number;
  /** Not with a set, which says them. */
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
 * Every quantity of the last step and of the episode, in SI units, under the names of `quantities`, and what the task
 * shows. Of a disturbed plant what the sensors show, and what the episode has drawn.
 */
export type Info = {
  [quantity: string]: number | string | Record<string, number> | undefined;
  reading?: Record<string, number>;
  capsule?: Record<string, number>;
  disturbances?: Record<string, number>;
  termination: "none" | "pendulum" | "contact" | "diverged";
};

/** The numbers of `capsule_gym.task.Metrics`. */
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
  /** 1 where the episode has failed, else 0. */
  failed: number;
  /** Of the task "goal": 1 where it was reached, and when, s. */
  success?: number;
  goal_time?: number;
  /** Of the task "velocity": in percent of the commands, and the share of those that were not settled. */
  velocity_error?: number;
  unsettled?: number;
}

export interface StepResult {
  observation: Float32Array;
  reward: number;
  terminated: boolean;
  truncated: boolean;
  info: Info;
}

/** All that a capsule and its driver remember. */
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
  /** Length of an episode, s, by tasks. */
  horizons: Record<string, number>;
  torque_limit: number;
  theta_limit: number;
  m: number;
  l: number;
  g: number;
  nominal: Plant & Record<string, number>;
  /** Where environments draw M and mu from. */
  ranges: Record<string, { M: [number, number]; mu: [number, number] }>;
  /** What `reset` and `setPlant` accept of M and mu, and `reset` of a disturbed plant's other constants. */
  limits: { M: [number, number]; mu: [number, number] } & Record<string, [number, number]>;
  /** What `disturbances: "real"` is. */
  real: Disturbances;
  start: State;
  largest_state: State;
};

/** One capsule with a law inside its step, or with none. */
export class Capsule {
  private constructor();
  readonly task: string;
  /** Whether an episode draws anything, and so may have a seed. */
  readonly draws: boolean;
  readonly controlDt: number;
  readonly horizon: number;
  readonly state: State;
  readonly observation: Float32Array;
  readonly info: Info;
  readonly metrics: Metrics;
  /** In the order of `quantities`, then the law's memory, its line of the reference, the task's memory, the history. */
  readonly world: Float64Array;
  reset(start?: Start): { observation: Float32Array; info: Info };
  step(action: number): StepResult;
  setPlant(plant: Plant): void;
  snapshot(): Snapshot;
  restore(snapshot: Snapshot): void;
}

/** A capsule and what drives it, in closed loop. */
export class Episode extends Capsule {
  readonly driver: string;
  readonly action: number;
  reset(start?: (Start | Frozen) & Pick<Told, "seed">): { observation: Float32Array; info: Info };
  /** `step`, whose action the driver chooses. */
  tick(): StepResult;
}

export function load(
  controller: string,
  options?: { task?: string; disturbances?: "none" | "real" | Disturbances } | { set: string },
): Promise<Capsule>;
export function drive(driver: string, options?: (Start | Frozen) & Told): Promise<Episode>;
/** A policy of one's own: the JSON of what `web.data.describe_policy` says of it in Python. */
export interface OwnDriver {
  /** Not that of another driver. */
  name: string;
  description: string;
  kind: "policy";
  /** One of `tasks`, and of `controllers`. */
  task: string;
  controller: string;
  seed?: number;
  /** The step's settings, plain and disturbed, of the package's own layout; control_dt in s. */
  settings: {
    fixed: number[];
    varied: number[];
    capsule: number[];
    disturbances: "none" | "real" | Disturbances;
    entries: number;
    control_dt: number;
    steps: number;
  };
  /** The packed network, of the package's own layout. */
  network: number[];
  /** The most units of a layer. */
  units: number;
}

/** Makes a policy of one's own one of `drivers`. */
export function addDriver(driver: OwnDriver): void;
export function check(
  report?: (result: { name: string; equal: boolean; steps: number; doubles: number }) => void,
): Promise<boolean>;
