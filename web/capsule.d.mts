/** What drives a capsule, as `drivers` lists it. */
export interface Driver {
  name: string;
  description: string;
  kind: "law" | "gait" | "policy" | "recording" | "none";
  /** Which law lies inside the step; one of `tasks`. */
  task: string;
  /** Seed of a policy's training run. */
  seed?: number;
  /** Energy weights that a policy can be told, cm/J. */
  energyWeight?: [number, number];
  /** Whether what it does is recorded, on the plants of the frozen sets alone. */
  recorded?: boolean;
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

/** How an episode begins; what is left out is nominal. */
export interface Start extends Partial<Plant>, Partial<State> {
  changes?: Change[];
}

/** A plant of a frozen set, with its start and its jumps. */
export interface Frozen {
  set: string;
  /** From 0. */
  plant: number;
}

/** What a driver is told besides. */
export interface Told {
  /** cm/J. */
  energyWeight?: number;
  /** Where it draws random torques; that of a frozen plant is its number. */
  seed?: number;
}

/** A plant of a frozen set. */
export interface FrozenPlant extends Plant {
  theta?: number;
  changes?: Change[];
}

/** Every quantity of the last step and of the episode, in SI units, under the names of `quantities`. */
export type Info = {
  [quantity: string]: number | string;
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
export const tasks: readonly string[];
export const quantities: readonly string[];
export const sets: Readonly<Record<string, { hash: string; plants: FrozenPlant[] }>>;
export const constants: {
  control_dt: number;
  steps: number;
  torque_limit: number;
  theta_limit: number;
  m: number;
  l: number;
  g: number;
  nominal: Plant;
  /** Where environments draw M and mu from. */
  ranges: Record<string, { M: [number, number]; mu: [number, number] }>;
  /** What `reset` and `setPlant` accept. */
  limits: { M: [number, number]; mu: [number, number] };
  start: State;
  largest_state: State;
};

/** One capsule with a law inside its step, or with none. */
export class Capsule {
  private constructor();
  readonly controlDt: number;
  readonly horizon: number;
  readonly state: State;
  readonly observation: Float32Array;
  readonly info: Info;
  readonly metrics: Metrics;
  /** In the order of `quantities`, then the law's memory and its line of the reference. */
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

export function load(task: string): Promise<Capsule>;
export function drive(driver: string, options?: (Start | Frozen) & Told): Promise<Episode>;
/** A policy of one's own: the JSON of what `web.data.describe_policy` says of it in Python. */
export interface OwnDriver {
  /** Not that of another driver. */
  name: string;
  description: string;
  kind: "policy";
  /** One of `tasks`. */
  task: string;
  seed?: number;
  /** The step's settings, of the package's own layout; control_dt in s. */
  settings: { fixed: number[]; entries: number; control_dt: number; steps: number };
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
