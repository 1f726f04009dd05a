// Prints what the viewer costs; see figures.sh.
import { spawn } from "node:child_process";
import { readFileSync } from "node:fs";
import { setTimeout as sleep } from "node:timers/promises";
import { chromium } from "playwright-core";
import { Program, ViewerProgram, until } from "./programs.mjs";

const kSensors = ["--scan", "LASER", "--pose", "POSE"];
const kSpeed = 10;
const kSeconds = 40;

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});

async function open(url) {
  const page = await browser.newPage({ viewport: { width: 1280, height: 800 } });
  await page.goto(url);
  return page;
}

// A field of /proc/ID/status in MB, and the seconds of processor of a process.
const rss_mb = (id) => Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${id}/status`, "utf8"))[1]) / 1024;
function cpu_s(id) {
  const fields = readFileSync(`/proc/${id}/stat`, "utf8").replace(/.*\) /, "").split(" ");
  return (Number(fields[11]) + Number(fields[12])) / 100;
}
async function metric(url, name) {
  const text = await (await fetch(new URL("/metrics", url))).text();
  return Number(new RegExp(`^${name} (\\S+)`, "m").exec(text)[1]);
}
const median = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];
const percentile = (values, p) => [...values].sort((a, b) => a - b)[Math.floor(p * (values.length - 1))];
const ms = (value) => `${value.toFixed(0)} ms`;

// When each revision was drawn, by the clock of the page, which is that of the host.
async function watchRevisions(page) {
  await page.evaluate(() => {
    const drawn = (window.drawn = {});
    let seen = -1;
    let frames = 0;
    const look = () => {
      const { revision, frameCount } = window.splinemapViewer;
      if (revision !== seen && frameCount !== frames) {
        drawn[revision] = performance.timeOrigin + performance.now();
        seen = revision;
        frames = frameCount;
      }
      requestAnimationFrame(look);
    };
    look();
  });
}

// Times of reception of the messages of a channel in a log that lcm-logger wrote, in ms.
function timesOf(log, channel) {
  const bytes = readFileSync(log);
  const times = [];
  for (let at = 0; at + 28 <= bytes.length; ) {
    const nameSize = bytes.readUInt32BE(at + 20);
    const size = bytes.readUInt32BE(at + 24);
    if (bytes.toString("utf8", at + 28, at + 28 + nameSize) === channel)
      times.push(Number(bytes.readBigInt64BE(at + 12)) / 1000);
    at += 28 + nameSize + size;
  }
  return times;
}

// A drive with so many pages open; the first is measured.
async function drive(pages) {
  const daemon = new Program("splinemapd", "--map", `live-${pages}.splinemap`, "--name", "robot", ...kSensors);
  const viewer = new ViewerProgram({ flags: kSensors });
  const url = await viewer.url();
  const opened = [];
  for (let n = 0; n < pages; ++n) opened.push(await open(url));
  const [page] = opened;
  await until("the daemon", async () => (await page.locator("#daemons").textContent()).includes("robot"));
  await watchRevisions(page);
  const log = `heard-${pages}.lcmlog`;
  const logger = spawn("lcm-logger", ["--quiet", "--force", log], { stdio: "ignore" });
  await sleep(500);
  const before = { frames: await page.evaluate(() => window.splinemapViewer.frameCount),
                   bytes: await metric(url, "splinemap_viewer_frame_bytes_total"), cpu_s: cpu_s(viewer.child.pid) };
  const player = spawn("lcm-logplayer", ["-s", String(kSpeed), "drive.lcmlog"], { stdio: "ignore" });
  await sleep(kSeconds * 1000);
  player.kill();
  logger.kill();
  const frames = (await page.evaluate(() => window.splinemapViewer.frameCount)) - before.frames;
  const bytes = (await metric(url, "splinemap_viewer_frame_bytes_total")) - before.bytes;
  const draw_ms = await page.evaluate(() => window.splinemapViewer.drawTime_ms);
  const drawn = await page.evaluate(() => window.drawn);
  const scans = timesOf(log, "LASER");
  const updates = timesOf(log, "SPLINEMAP_UPDATES");
  const toPixel = [];
  const toBus = [];
  for (let n = 0; n < scans.length; ++n) {
    const later = Object.entries(drawn).find(([revision]) => Number(revision) >= n + 1);
    if (later) toPixel.push(later[1] - scans[n]);
    const update = updates.find((time) => time >= scans[n]);
    if (update) toBus.push(update - scans[n]);
  }
  console.log(
    `${pages} page${pages > 1 ? "s" : ""}: ${(frames / kSeconds).toFixed(1)} pictures a second (${ms(draw_ms)} each), ` +
      `${(bytes / kSeconds / 1000 / pages).toFixed(1)} kB/s to a page, scan to pixel ${ms(median(toPixel))} ` +
      `(90 %: ${ms(percentile(toPixel, 0.9))}), scan to the bus, where replicas hear it, ${ms(median(toBus))}: ` +
      `${(median(toPixel) / median(toBus)).toFixed(1)} times; ${scans.length} scans; viewer ` +
      `${((100 * (cpu_s(viewer.child.pid) - before.cpu_s)) / kSeconds).toFixed(0)} % of a processor, ${rss_mb(viewer.child.pid).toFixed(0)} MB`,
  );
  for (const one of opened) await one.close();
  await viewer.end();
  await daemon.end();
}

async function largeMap() {
  const viewer = new ViewerProgram({ flags: ["one.splinemap"] });
  const url = await viewer.url();
  const started = Date.now();
  const page = await open(url);
  await until("the whole map", () => page.evaluate(() => window.splinemapViewer?.isComplete));
  const first_ms = Date.now() - started;
  const tiles = await metric(url, "splinemap_viewer_tiles");
  const heaps = [];
  for (const metres_per_pixel of [0.2, 0.05, 0.02, 0.5]) {
    const begin = Date.now();
    await page.evaluate((to) => window.splinemapViewer.setView({ ...window.splinemapViewer.view, ...to }), { metres_per_pixel });
    await until("the view", () => page.evaluate(() => window.splinemapViewer.isComplete));
    heaps.push(`${metres_per_pixel} m/px in ${ms(Date.now() - begin)}, ${await page.evaluate(() => window.splinemapViewer.tileCount)} tiles`);
  }
  const heap_mb = await page.evaluate(() => performance.memory.usedJSHeapSize / 1e6);
  console.log(`${tiles} tiles: first picture after ${ms(first_ms)}; ${heaps.join("; ")}; page ${heap_mb.toFixed(0)} MB of heap, viewer ${rss_mb(viewer.child.pid).toFixed(0)} MB`);
  await page.close();
  await viewer.end();
}

await largeMap();
await drive(1);
await drive(20);
await browser.close();
