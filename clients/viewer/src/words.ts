// What states, problems and figures are called. Nothing here touches the page.

import { CheckAnswer } from "./api";
import { ConnectionState } from "./connection";
import { Daemon, Layer, MapInfo, MapTimes } from "./frame";
import { LiveState } from "./live_state";

const kProblems: Record<string, string> = {
  odd_readings: "The scanner's ranges look wrong: other units, or many at one range.",
  useless_beam_times: "beam_times is set, but all beams of a scan have one time.",
  options_disagree: "Other options of the scanner would make a sharper map: run splinemap doctor.",
  without_poses: "Scans come without poses around them: another clock, or no pose channel.",
  map_disagrees: "Hits lie where the map is free: the localisation jumped or drifts.",
  time_jump: "Time in the messages stepped back: a log was started again, or a clock was set.",
  coarse_poses: "Poses are floats far from the origin, in steps of centimetres.",
  pose_jump: "Poses jump as no robot moves: two localisations on one channel, or a slip.",
  host_clock_jump: "The clock of the daemon's computer was set.",
  silence: "A channel is silent: nothing came for 5 s.",
  lost_datagrams: "The system dropped messages: its receive buffer is too small.",
  shared_identity: "Somebody else publishes this daemon's layer: a copied map file, or a replay.",
  shared_name: "Two layers have one name: two robots, or an old map file.",
  refused_layer: "A layer cannot be added to the map: other knots, or too large.",
  refused_setting: "A setting of a layer came that no daemon makes.",
  disowned_tiles: "Tiles came in the name of a robot that does not have them.",
  layers_contradict: "A layer has obstacles where the others saw free space: another frame?",
  bus_away: "The LCM bus cannot be opened, or broke off.",
  refused_requests: "Clients ask more than the daemon can answer.",
  malformed_messages: "Corrupt messages came on splinemap's own channels.",
  dropped_updates: "Messages about layers came faster than they were handled.",
  lost_log_lines: "Nobody reads the daemon's log.",
};

const kDrops: Record<string, string> = {
  wrong_type_of_scan: "of another type than a scan",
  wrong_type_of_pose: "of another type than a pose",
  malformed_scan: "malformed scans",
  malformed_pose: "malformed poses",
  malformed_extrinsics: "malformed extrinsics",
  unusable_scan: "unusable scans",
  no_extrinsics: "scans before their extrinsics",
  duplicate_scan: "scans sent twice",
  duplicate_pose: "poses sent twice",
  late_scan: "late scans",
  scan_without_pose: "scans without a pose",
  scan_in_pose_gap: "scans in a gap of the poses",
  scan_in_pose_jump: "scans in a jump of the poses",
  tilted_scan: "scans of a tilted robot",
  pose_out_of_range: "poses out of range",
  map_full: "scans because the map is full",
  scan_queue_full: "scans because too many waited",
  overload: "scans because of overload",
  stood_still: "scans while it stood still",
};

const kLayerStates: Record<Layer["state"], string> = {
  own: "mapped here",
  live: "live",
  stale: "behind",
  gone: "silent",
  removed: "removed",
  file: "from a file",
};

export const kDaemonSilent_s = 3;

export function problemSentence(name: string): string {
  return kProblems[name] ?? `Problem “${name}”.`;
}

export function dropPhrase(reason: string): string {
  return kDrops[reason] ?? reason;
}

export function layerState(layer: Layer): string {
  const words = [kLayerStates[layer.state] ?? layer.state];
  if (layer.is_muted) words.push("muted");
  if (layer.is_low_weight) words.push("low weight");
  const { x_m, y_m, yaw_rad } = layer.placement;
  if (x_m !== 0 || y_m !== 0 || yaw_rad !== 0) {
    words.push(`placed at ${metres(x_m)}, ${metres(y_m)}, ${degrees(yaw_rad)}`);
  }
  if (layer.is_approximate) words.push("approximate");
  if ((layer.contradicted ?? -1) > 0.1) words.push(`${percent(layer.contradicted!)} contradicted`);
  return words.join(" · ");
}

export function layerFigures(layer: Layer): string {
  const tiles = countOf(layer.tiles, "tile");
  if (layer.state === "file") return tiles;
  if (layer.staleness_ms === null) return `${tiles} · never in sync`;
  const heard =
    layer.heard_s_ago >= kDaemonSilent_s ? `heard ${duration(layer.heard_s_ago)} ago` : "";
  return [tiles, heard || `${duration(layer.staleness_ms / 1000)} old`].join(" · ");
}

export type Tone = "ok" | "busy" | "warn" | "bad";

// The state of everything: a word, and a sentence where something is not as it should be.
export interface Status {
  tone: Tone;
  word: string;
  title: string; // "": nothing to say
  lines: string[];
}

function status(tone: Tone, word: string, title = "", lines: string[] = []): Status {
  return { tone, word, title, lines };
}

export function statusOf(connection: ConnectionState, live: LiveState): Status {
  const trouble = connectionTrouble(connection);
  if (trouble) return trouble;
  const { map } = live;
  if (!map) return status("busy", "Connecting", "Waiting for the map");
  if (map.source === "file") return fileStatus(map, live.times);
  const isFleet = map.source === "fleet";
  return (isFleet ? fleetTrouble(map, live) : busTrouble(map, live)) ?? status("ok", "Live");
}

function connectionTrouble(connection: ConnectionState): Status | null {
  switch (connection) {
    case "open":
      return null;
    case "connecting":
      return status("busy", "Connecting", "Connecting to the viewer's server");
    case "refused":
      return status("bad", "No access", "The token is missing or wrong", [
        "Open the address that the server printed, with its ?token=",
      ]);
    case "lost":
      return status("bad", "Disconnected", "The connection to the server is lost", [
        "What is shown may be old. Trying again.",
      ]);
  }
}

function fileStatus(map: MapInfo, times: MapTimes | null): Status {
  const isPast = times !== null && times.shown_utime !== null;
  const word = isPast ? "Past" : "File";
  if (times?.problem) {
    const shown = isPast ? timeText(times.shown_utime!, false) : "now";
    const lines = [`${times.problem}.`, `What is shown is the map of ${shown}.`];
    return status("warn", word, "The map of then cannot be made", lines);
  }
  if (isPast) return status("warn", word, map.bounds ? "" : "Nothing was mapped by then");
  if (map.bounds) return status("ok", word);
  return status("warn", "File", "This map is empty", ["Nothing was mapped into the file."]);
}

function busTrouble(map: MapInfo, live: LiveState): Status | null {
  if (map.problem) return status("bad", "No bus", "The LCM bus is away", [map.problem]);
  if (!map.bounds) return emptyStatus(live);
  const gone = live.daemons.filter((daemon) => daemon.heard_s_ago > kDaemonSilent_s);
  if (live.daemons.length > 0 && gone.length === live.daemons.length) {
    return status("bad", "Daemon gone", goneSentence(gone), ["The map is as it was then."]);
  }
  if (gone.length > 0) return status("warn", "Live", goneSentence(gone));
  if (!map.is_caught_up) {
    return status("warn", "Catching up");
  }
  return null;
}

function fleetTrouble(map: MapInfo, live: LiveState): Status | null {
  if (map.problem) return status("bad", "No fleet", "The fleet is away", [map.problem]);
  if (!map.is_caught_up) return status("warn", "Catching up");
  if (!map.bounds) return emptyStatus(live);
  return null;
}

function emptyStatus(live: LiveState): Status {
  const isSummed = (layer: Layer) => !layer.is_muted && layer.state !== "removed";
  if (live.layers.length > 0 && !live.layers.some(isSummed)) {
    return status("warn", "Muted", "All layers are muted or removed");
  }
  return status("warn", "Empty", "Nothing mapped yet", reasonsForNothing(live));
}

function goneSentence(gone: Daemon[]): string {
  const names = gone.slice(0, 3).map((daemon) => daemon.name || "a daemon");
  const more = gone.length > 3 ? ` and ${gone.length - 3} more` : "";
  const heard_s = Math.min(...gone.map((daemon) => daemon.heard_s_ago));
  return `Not heard for ${duration(heard_s)}: ${names.join(", ")}${more}`;
}

// Why there is no map: the first that is missing on the way from the bus to a commit.
function reasonsForNothing(live: LiveState): string[] {
  if (live.map?.source === "fleet") return ["No robot has sent its layer yet."];
  if (live.daemons.length === 0) {
    return ["No splinemapd is heard on this bus. Does it run, on the same LCM URL?"];
  }
  return live.daemons.slice(0, 4).flatMap((daemon) => {
    const reason = reasonOf(daemon);
    const found = daemon.problems.filter((problem) => problem.count > 0);
    const sentences = found.map((problem) => problemSentence(problem.name));
    return [`${daemon.name}: ${reason}`, ...sentences, daemon.last_problem].filter(Boolean);
  });
}

function reasonOf(daemon: Daemon): string {
  if (daemon.heard_s_ago > kDaemonSilent_s) return `silent for ${duration(daemon.heard_s_ago)}.`;
  if (daemon.scans_received === 0) return "no scan came yet. Is its scan channel right?";
  if (daemon.scans_mapped > 0) return "its map is on the way.";
  const worst = [...daemon.drops].sort((a, b) => b.count - a.count)[0];
  const received = `${countOf(daemon.scans_received, "scan")} came and none was mapped`;
  return worst
    ? `${received}: ${worst.count} dropped, ${dropPhrase(worst.reason)}.`
    : `${received}.`;
}

export function isBeingMade({ shown_utime, wanted_utime, problem }: MapTimes): boolean {
  return wanted_utime !== shown_utime && !problem;
}

const kDay_us = 86_400e6;

// In UTC, as --at takes it. Clocks without a date count from their start.
export function timeText(utime: number, hasTenths: boolean): string {
  const time = new Date(utime / 1000);
  if (Number.isNaN(time.getTime())) return `${utime} µs`; // beyond the dates that there are
  const tenths = /T([\d:]+\.\d)/.exec(time.toISOString())![1]!;
  const clock = hasTenths ? tenths : tenths.slice(0, -2);
  if (utime < kDay_us) return `${clock} on the robot's clock`;
  const options = { day: "numeric", month: "long", year: "numeric", timeZone: "UTC" } as const;
  return `${time.toLocaleDateString("en-GB", options)}, ${clock} UTC`;
}

export function checkSentence(answer: CheckAnswer, radius_m: number, length_m: number): string {
  const disc = `a disc of radius ${metres(radius_m)}`;
  if (answer.occupancy === "free" && answer.is_certified) {
    return `Free for ${disc}, ${metres(length_m)} long.`;
  }
  if (answer.occupancy === "free") return `No obstacle found for ${disc}, but this is not certain.`;
  const where = answer.contact ? `, at ${place(answer.contact.x_m, answer.contact.y_m)}` : "";
  if (answer.occupancy === "occupied") return `Blocked after ${metres(answer.free_m)}${where}.`;
  return `Free for ${metres(answer.free_m)}; what follows was never seen${where}.`;
}

export function metres(value_m: number): string {
  const digits = Math.abs(value_m) >= 1000 ? 0 : 2;
  return `${value_m.toFixed(digits)} m`;
}

export function place(x_m: number, y_m: number): string {
  return `(${x_m.toFixed(2)}, ${y_m.toFixed(2)})`;
}

export function percent(part: number): string {
  return `${Math.round(100 * part)} %`;
}

export function duration(s: number): string {
  if (s < 10) return s < 1 ? `${Math.round(1000 * s)} ms` : `${s.toFixed(1)} s`;
  if (s < 120) return `${Math.round(s)} s`;
  if (s < 7200) return `${Math.round(s / 60)} min`;
  return `${Math.round(s / 3600)} h`;
}

export function countOf(count: number, noun: string): string {
  return `${count.toLocaleString("en")} ${noun}${count === 1 ? "" : "s"}`;
}

export function signed(value: number, digits = 2): string {
  return `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;
}

export function degrees(rad: number): string {
  return `${Math.round((rad * 180) / Math.PI)}°`;
}
