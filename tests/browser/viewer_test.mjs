// The page of splinemap-viewer in a browser, beside a daemon, on the bus of LCM_DEFAULT_URL. In the
// current folder is office.lcmlog, a simulated drive. The cases go on from each other.
import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { after, before, test } from "node:test";
import { chromium } from "playwright-core";
import { Program, ViewerProgram, output, until } from "./programs.mjs";

const kScan = "#d4145a"; // the overlay's, in the light theme
const kUnknown = [176, 190, 205];
const kSensors = ["--scan", "LASER", "--pose", "POSE"];

let browser;
let daemon;
let viewer;
let url;
let page;
const requests = []; // of all pages
const errors = []; // in the console, while all programs run
let listensForErrors = true;

before(async () => {
  daemon = startDaemon();
  viewer = new ViewerProgram({ flags: [...kSensors, "--allow-commands"] });
  url = await viewer.url();
  browser = await chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    args: ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
});

after(async () => {
  await browser?.close();
  await viewer?.end();
  await daemon?.end();
});

function startDaemon() {
  return new Program("splinemapd", "--map", "live.splinemap", "--name", "robot", ...kSensors);
}

async function open(at, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, ...options });
  const opened = await context.newPage();
  opened.on("request", (request) => requests.push(request.url()));
  opened.on("websocket", (socket) => requests.push(socket.url()));
  opened.on("pageerror", (error) => errors.push(String(error)));
  opened.on("console", (message) => {
    if (listensForErrors && message.type() === "error") errors.push(message.text());
  });
  await opened.goto(at);
  return opened;
}

const hook = (of, name) => of.evaluate((key) => window.splinemapViewer[key], name);
const text = (of, id) => of.locator(`#${id}`).textContent();

async function untilStatus(of, word) {
  await until(`the page says "${word}"`, async () => (await text(of, "status")) === word);
}

async function see(of, view) {
  await of.evaluate((to) => window.splinemapViewer.setView(to), view);
  await until("all tiles are there", () => hook(of, "isComplete"));
}

async function picture(of, name) {
  if (process.env.SPLINEMAP_PICTURES) {
    await of.screenshot({ path: `${process.env.SPLINEMAP_PICTURES}/${name}.png` });
  }
}

// How many pixels of the overlay have the colour, or any.
function overlayPixels(of, colour) {
  return of.evaluate((css) => {
    const canvas = document.getElementById("overlay");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const wanted = css && [1, 3, 5].map((at) => parseInt(css.slice(at, at + 2), 16));
    let count = 0;
    for (let k = 0; k < data.length; k += 4) {
      if (data[k + 3] < 100) continue;
      if (!wanted || wanted.every((value, n) => Math.abs(value - data[k + n]) <= 2)) ++count;
    }
    return count;
  }, colour);
}

// Pixels of the map that was drawn, by chance: their middles in the map frame, and colours.
function samplePixels(of, count) {
  return of.evaluate((wanted) => {
    const { width, height, data } = window.splinemapViewer.readPixels();
    let seed = 1;
    const random = (end) => (seed = (seed * 48271) % 2147483647) % end;
    return Array.from({ length: wanted }, () => {
      const [x, y] = [random(width), random(height)];
      const density = window.devicePixelRatio;
      const { x_m, y_m } = window.splinemapViewer.pixelToWorld((x + 0.5) / density, (y + 0.5) / density);
      const at = 4 * (width * y + x);
      return { x_m, y_m, rgb: [...data.slice(at, at + 3)] };
    });
  }, count);
}

// What splinemap query says of points in a saved map.
function query(map, points, ...flags) {
  const input = points.map(({ x_m, y_m }) => `${x_m},${y_m}\n`).join("");
  const args = ["query", map, "--points", "-", ...flags];
  const lines = output("splinemap", args, { input }).trim().split("\n");
  return lines.map((line) => {
    const [, , log_odds, probability, dx, dy, known] = line.split(",").map(Number);
    return { log_odds, probability, gradient_per_m: Math.hypot(dx, dy), known: known === 1 };
  });
}

// The picture is what the saved map says, within one grey level.
async function comparePixels(of, view, map = "office.splinemap", ...flags) {
  await see(of, view);
  const pixels = await samplePixels(of, 12_000);
  const samples = query(map, pixels, ...flags);
  assert.equal(samples.length, pixels.length);
  const counts = { known: 0, unknown: 0, edge: 0 };
  pixels.forEach(({ x_m, y_m, rgb }, k) => {
    const { known, probability } = samples[k];
    const grey = 255 - Math.round(254 * probability);
    const wanted = known ? [grey, grey, grey] : kUnknown;
    const difference = Math.max(...rgb.map((value, n) => Math.abs(value - wanted[n])));
    assert.ok(difference <= 1, `at ${x_m}, ${y_m}: ${rgb} in place of ${wanted}`);
    ++counts[known ? "known" : "unknown"];
    if (known && grey > 20 && grey < 235) ++counts.edge;
  });
  return counts;
}

async function clickAt(of, x_m, y_m) {
  const at = await of.evaluate(([x, y]) => {
    const { left, top } = document.getElementById("map").getBoundingClientRect();
    const { x_px, y_px } = window.splinemapViewer.worldToPixel(x, y);
    const pixel = { x: Math.round(left + x_px), y: Math.round(top + y_px) };
    return { ...pixel, ...window.splinemapViewer.pixelToWorld(pixel.x - left, pixel.y - top) };
  }, [x_m, y_m]);
  await of.mouse.click(at.x, at.y);
  return at;
}

const signed = (value) => `${value < 0 ? "\u2212" : "+"}${Math.abs(value).toFixed(2)}`;

async function cardText(of, pattern) {
  return await until(`the card says ${pattern}`, async () => {
    const words = await text(of, "card-text");
    return pattern.test(words) && words;
  });
}

test("the page comes from the program", async () => {
  page = await open(url);
  await until("the page is connected", () => hook(page, "isConnected"));
  await untilStatus(page, "Empty");
  await until("the daemon is listed", async () => (await text(page, "daemons")).includes("robot"));
  assert.match(await text(page, "banner-title"), /Nothing mapped yet/);
});

test("a drive appears while it goes on", async () => {
  const drive = new Program("lcm-logplayer", "-s", "40", "office.lcmlog");
  let hasEnded = false;
  void drive.ended.then(() => (hasEnded = true));
  await until("tiles", async () => (await hook(page, "tileCount")) > 30);
  await until("the robot is listed", async () => (await text(page, "robots")).includes("POSE"));
  await until("hits of the scan", async () => (await overlayPixels(page, kScan)) > 50);
  const early = await hook(page, "revision");
  assert.ok(!hasEnded, "the drive ended first");
  await picture(page, "drive");
  await drive.ended;
  output("splinemap", ["snapshot", "office.splinemap"]);
  const [{ commits }] = JSON.parse(output("splinemap", ["layers", "office.splinemap", "--json"]));
  assert.ok(commits > early + 100, `${early} commits at the first tiles, ${commits} in the end`);
  await until("all commits", async () => (await hook(page, "revision")) === commits);
  await untilStatus(page, "Live");
  assert.equal(await page.locator("#banner").isVisible(), false);
  assert.match(await text(page, "layers"), /robot.*mapped here/);
  assert.equal(await page.locator("#times").isVisible(), false, "the bus has the map of now alone");

  // What lies over the map goes with its box.
  for (const shown of ["scans", "trails", "robots"]) {
    const box = page.locator(`[data-shown=${shown}]`);
    const before_px = await overlayPixels(page);
    await box.uncheck();
    await until(`without ${shown}`, async () => (await overlayPixels(page)) < before_px - 50);
    if (shown === "scans") await until("no hits", async () => (await overlayPixels(page, kScan)) === 0);
  }
  assert.equal(await overlayPixels(page), 0);
  for (const shown of ["scans", "trails", "robots"]) await page.locator(`[data-shown=${shown}]`).check();
  await picture(page, "map");
});

test("the picture is the surface within one grey level", async () => {
  const views = [[12.013, 6.507, 0.03], [6.11, 4.97, 0.0123], [14.53, 7.31, 0.0031]];
  const sum = { known: 0, unknown: 0, edge: 0 };
  for (const [centre_x_m, centre_y_m, metres_per_pixel] of views) {
    const counts = await comparePixels(page, { centre_x_m, centre_y_m, metres_per_pixel });
    assert.equal(await hook(page, "level"), 0);
    for (const name of Object.keys(sum)) sum[name] += counts[name];
  }
  assert.ok(sum.known > 5000 && sum.unknown > 3000 && sum.edge > 300, JSON.stringify(sum));
  console.log(`viewer: ${sum.known} known and ${sum.unknown} unknown pixels within one grey level`);
});

test("the server's own picture is the page's", async () => {
  await see(page, { centre_x_m: 6.11, centre_y_m: 4.97, metres_per_pixel: 0.0123 });
  const { worst, count } = await page.evaluate(async () => {
    const { width, height, data } = window.splinemapViewer.readPixels();
    const lower = window.splinemapViewer.pixelToWorld(0, height);
    const upper = window.splinemapViewer.pixelToWorld(width, 0);
    const box = [lower.x_m, lower.y_m, upper.x_m, upper.y_m].join(",");
    const answer = await fetch(`map.png?bbox=${box}&px=${width}`);
    const canvas = new OffscreenCanvas(width, height);
    const context = canvas.getContext("2d");
    context.drawImage(await createImageBitmap(await answer.blob()), 0, 0);
    const other = context.getImageData(0, 0, width, height).data;
    let found = 0;
    for (let k = 0; k < data.length; ++k) found = Math.max(found, Math.abs(data[k] - other[k]));
    return { worst: found, count: width * height };
  });
  assert.ok(worst <= 1, `${worst} grey levels`);
  assert.ok(count > 500_000);
});

test("the card is what splinemap query says", async () => {
  await see(page, { centre_x_m: 12, centre_y_m: 6.5, metres_per_pixel: 0.03 });
  const kinds = new Set();
  const column = Array.from({ length: 500 }, (_, k) => ({ x_m: 7, y_m: 6 + 0.01 * k }));
  const wall = column[query("office.splinemap", column).findIndex(({ probability }) => probability > 0.9)];
  for (const { x_m, y_m } of [{ x_m: 7, y_m: 6.3 }, wall, { x_m: 12, y_m: -2 }, { x_m: 18, y_m: 6.3 }]) {
    const [sample] = query("office.splinemap", [await clickAt(page, x_m, y_m)]);
    const words = sample.known ? /^Seen/ : /^Never seen/;
    await cardText(page, words);
    const rows = await page.locator("#card-rows dd").allTextContents();
    assert.equal(rows[0], sample.probability.toFixed(3));
    assert.equal(rows[1], signed(sample.log_odds));
    assert.match(rows[2], new RegExp(`^${sample.gradient_per_m.toFixed(1)} /m`));
    const layer = sample.known ? `robot${signed(sample.log_odds)}` : "robotnever seen";
    assert.equal(await text(page, "card-layers"), layer);
    kinds.add(sample.known ? sample.probability > 0.5 : "unknown");
  }
  assert.deepEqual([...kinds].map(String).sort(), ["false", "true", "unknown"]);
  await picture(page, "card");
});

test("a segment's verdict is that of splinemap check", async () => {
  await page.keyboard.press("s");
  for (const { ends: [from, to], verdict } of [
    { ends: [[9, 6.3], [15, 6.3]], verdict: "free" },
    { ends: [[7, 6.3], [7, 9.5]], verdict: "occupied" },
  ]) {
    const a = await clickAt(page, ...from);
    const b = await clickAt(page, ...to);
    const radius_m = await page.locator("#radius").inputValue();
    const points = [a.x_m, a.y_m, b.x_m, b.y_m].map(String);
    const args = ["check", "office.splinemap", ...points, "--radius", radius_m, "--json"];
    const answer = JSON.parse(output("splinemap", args, { status: verdict === "free" ? 0 : 1 }));
    assert.equal(answer.occupancy, verdict);
    const words = await cardText(page, /^(Free|Blocked|No)/);
    const contact = `(${answer.contact_x_m?.toFixed(2)}, ${answer.contact_y_m?.toFixed(2)})`;
    const length_m = Math.hypot(b.x_m - a.x_m, b.y_m - a.y_m).toFixed(2);
    const wanted = verdict === "free"
      ? `Free for a disc of radius 0.20 m, ${length_m} m long.`
      : `Blocked after ${answer.free_m.toFixed(2)} m, at ${contact}.`;
    assert.equal(words, wanted);
    await picture(page, `segment_${verdict}`);
  }
  await page.keyboard.press("Escape");
});

test("goals and mutes are sent from the page", async () => {
  await page.keyboard.press("g");
  await clickAt(page, 12, 6.3);
  await cardText(page, /^Sent/);
  const isDrawn = async () => (await samplePixels(page, 500)).some(({ rgb }) => rgb[0] !== kUnknown[0]);
  assert.ok(await isDrawn());
  for (const isMuted of [true, false]) {
    await page.locator("#layers .mute").click();
    await until("the panel says so", async () => /muted/.test(await text(page, "layers")) === isMuted);
    await until("the map shows it", async () => (await isDrawn()) !== isMuted);
  }
  await page.keyboard.press("Escape");
});

test("two browsers see the same", async () => {
  const other = await open(url);
  const view = { centre_x_m: 12.1, centre_y_m: 6.4, metres_per_pixel: 0.021 };
  await until("the other is complete", () => hook(other, "isComplete"));
  const pictures = [];
  for (const each of [page, other]) {
    await see(each, view);
    pictures.push(JSON.stringify(await samplePixels(each, 5000)));
  }
  assert.equal(pictures[0], pictures[1]);
  assert.equal(await hook(other, "revision"), await hook(page, "revision"));
  await other.context().close();
});

test("a telephone, upright and across, light and dark", async () => {
  for (const [width, height, colorScheme] of [[390, 844, "light"], [844, 390, "dark"]]) {
    const phone = await open(url, { viewport: { width, height }, colorScheme, deviceScaleFactor: 2, hasTouch: true });
    await untilStatus(phone, "Live");
    await until("all tiles are there", () => hook(phone, "isComplete"));
    const { scrolls, theme, background, covered } = await phone.evaluate(() => {
      for (const part of document.querySelectorAll(".footing *")) part.style.pointerEvents = "auto";
      const isCovered = (button) => {
        const { left, top, bottom, width: side } = button.getBoundingClientRect();
        const isOnTop = (y) => button.contains(document.elementFromPoint(left + side / 2, y));
        return side > 0 && !(isOnTop(top + 3) && isOnTop(bottom - 3));
      };
      return {
        scrolls: document.documentElement.scrollWidth > innerWidth,
        theme: document.documentElement.dataset.theme,
        background: getComputedStyle(document.body).backgroundColor.match(/\d+/g).map(Number),
        covered: [...document.querySelectorAll("header.bar button, .stack button")].filter(isCovered).map((b) => b.title),
      };
    });
    await picture(phone, `${colorScheme}_${width}`);
    assert.equal(scrolls, false, "the page is wider than the screen");
    assert.deepEqual(covered, []);
    assert.equal(theme, colorScheme);
    assert.equal(Math.max(...background.slice(0, 3)) < 128, colorScheme === "dark", `${background}`);
    if (colorScheme === "light") {
      const counts = await comparePixels(phone, { centre_x_m: 12, centre_y_m: 6.5, metres_per_pixel: 0.0151 });
      assert.ok(counts.known > 3000, JSON.stringify(counts));
    }
    await phone.context().close();
  }
});

test("a daemon that is killed is told, and found again", async () => {
  await daemon.end("SIGKILL");
  await untilStatus(page, "Daemon gone");
  assert.match(await text(page, "banner-title"), /Not heard for .*: robot/);
  assert.ok((await hook(page, "tileCount")) > 30, "the map is gone");
  await picture(page, "daemon_gone");
  daemon = startDaemon();
  await untilStatus(page, "Live");
  assert.equal(await page.locator("#banner").isVisible(), false);
});

test("nothing but the program was asked, and nothing is in the console", () => {
  const { host } = new URL(url);
  const others = requests.filter((asked) => !/^(data|blob):/.test(asked) && new URL(asked).host !== host);
  assert.deepEqual(others, []);
  assert.ok(requests.some((asked) => asked.startsWith("ws://")) && requests.length > 10);
  assert.deepEqual(errors, []);
});

test("a viewer that is killed is told, and found again", async () => {
  listensForErrors = false; // browsers tell of each connection that is refused
  await viewer.end("SIGKILL");
  await untilStatus(page, "Disconnected");
  await picture(page, "disconnected");
  viewer = new ViewerProgram({ port: new URL(url).port, flags: kSensors });
  assert.equal(await viewer.url(), url);
  await untilStatus(page, "Live");
  await until("all tiles are there", () => hook(page, "isComplete"));
  assert.ok((await hook(page, "tileCount")) > 30);
});

test("names of the bus never become markup", async () => {
  const hostile = new Program("hostile_names", "bus");
  const open_viewer = new ViewerProgram(); // of all channels
  try {
    const shown = await open(await open_viewer.url());
    shown.on("dialog", (dialog) => errors.push(dialog.message()));
    for (const [id, name] of [["daemons", "Xname"], ["daemons", "Xlast"], ["daemons", "Xreason"],
                              ["daemons", "Xproblem"], ["robots", "Xchannel"], ["refused", "Xcoarse"],
                              ["layers", "Xmissing"]]) {
      await until(`${name} in ${id}`, async () => (await text(shown, id)).includes(`${name}<img`));
    }
    await shown.locator("#layers input").first().check(); // drawn alone, with its name in a label
    assert.equal(await shown.locator("img").count(), 0);
    await picture(shown, "hostile");
    assert.deepEqual(errors, []);
    assert.ok(!requests.some((asked) => asked.includes("hostile")), "an address of a name was asked");
    await shown.context().close();
  } finally {
    await open_viewer.end();
    await hostile.end();
  }
});

// The bytes of splinemap render and of the viewer's /map.png, of the same pixels.
async function renderBoth(of, map, ...flags) {
  const render = new Program("splinemap", "render", map, "rendered.png", "--force", "--px-per-knot", "2", ...flags);
  await render.ended;
  const grid = /(\d+) x (\d+) pixels of 0.025 m, left (\S+) m, top (\S+) m/.exec(render.log).slice(1).map(Number);
  const [width, height] = grid;
  const [left_m, top_m] = grid.slice(2).map((edge_m) => (Math.round(edge_m / 0.05 - 0.5) + 0.5) * 0.05); // not rounded
  const box = [left_m, top_m - 0.025 * height + 1e-6, left_m + 0.025 * width, top_m].join(",");
  const bytes = await of.evaluate(async (asked) => {
    const answer = await fetch(asked);
    return [...new Uint8Array(await answer.arrayBuffer())];
  }, `map.png?bbox=${box}&px=${width}`);
  return [readFileSync("rendered.png"), Buffer.from(bytes)];
}

async function expectMapOf(of, map, ...flags) {
  const [rendered, served] = await renderBoth(of, map, ...flags);
  assert.ok(rendered.equals(served), `map.png is not splinemap render ${flags.join(" ")}`);
  await comparePixels(of, { centre_x_m: 12, centre_y_m: 6.5, metres_per_pixel: 0.0251 }, map, ...flags);
}

const shownUtime = (of) => hook(of, "shownUtime");

test("a slider shows the map of a file as it was", async () => {
  output("splinemap", ["build", "office.lcmlog", "past.splinemap", ...kSensors, "--name", "robot"]);
  const file_viewer = new ViewerProgram({ flags: ["past.splinemap"] });
  try {
    const file_url = await file_viewer.url();
    const shown = await open(file_url);
    const slider = shown.locator("#time");
    await untilStatus(shown, "File");
    assert.match(await slider.getAttribute("aria-valuetext"), /^Now, 00:0\d:\d\d\.\d on the robot/);
    await expectMapOf(shown, "past.splinemap");

    await slider.fill("500");
    const middle = await until("the map of then", () => shownUtime(shown));
    await untilStatus(shown, "Past");
    assert.match(await text(shown, "time-text"), /^00:0\d:\d\d\.\d on the robot's clock$/);
    await expectMapOf(shown, "past.splinemap", "--at", String(middle));
    await picture(shown, "past");

    // Other pages see the same, and go with it.
    const other = await open(file_url, { viewport: { width: 390, height: 844 }, colorScheme: "dark", hasTouch: true });
    await untilStatus(other, "Past");
    assert.equal(await shownUtime(other), middle);
    assert.equal(await other.locator("#time").inputValue(), "500");
    await picture(other, "past_dark_390");
    await other.locator("#time").tap();
    await other.locator("#time-now").tap();
    await untilStatus(shown, "File");
    await until("the slider is at its end", async () => (await slider.inputValue()) === "1000");
    await expectMapOf(shown, "past.splinemap");

    // Keys.
    await slider.focus();
    const steps = [];
    for (const [key, isThere] of [["Home", (at) => at !== null], ["ArrowRight", (at) => at > steps[0]],
                                  ["PageUp", (at) => at > steps[1]], ["ArrowLeft", (at) => at < steps[2]],
                                  ["End", (at) => at === null]]) {
      await shown.keyboard.press(key);
      await until(`${key} moves the slider`, async () => isThere(await shownUtime(shown)));
      steps.push(await shownUtime(shown));
    }
    await expectMapOf(shown, "past.splinemap");

    // What no page says is refused, what lies beyond the scans is the nearest that there is.
    const say = (message) => other.evaluate(([to, said]) => new Promise((resolve) => {
      const socket = new WebSocket(to);
      socket.onopen = () => socket.send(said);
      socket.onclose = ({ code }) => resolve(code);
      socket.onmessage = () => setTimeout(() => resolve("taken"), 200);
    }), [`${file_url.replace("http", "ws")}live`, `{"at_utime":${message}}`]);
    for (const nonsense of ['"now"', "1.5", "1e300", "[1]", "{}", "true", ""]) {
      assert.equal(await say(nonsense), 1008, nonsense);
    }
    assert.equal(await say("-9223372036854775808"), "taken");
    await until("the first scan", async () => (await shownUtime(shown)) === steps[0]);
    assert.equal(await say("18446744073709551615"), "taken");
    await until("now", async () => (await shownUtime(shown)) === null);
    // Many at once: the last one counts.
    await other.evaluate(([to, at]) => {
      const socket = new WebSocket(to);
      socket.onopen = () => {
        for (let k = 0; k < 2000; ++k) socket.send(`{"at_utime":${(k * 7919) % (2 * at)}}`);
        socket.send(`{"at_utime":${at}}`);
      };
    }, [`${file_url.replace("http", "ws")}live`, middle]);
    await until("the last of many", async () => (await shownUtime(shown)) === middle);
    await expectMapOf(shown, "past.splinemap", "--at", String(middle));
    await other.context().close();
    assert.deepEqual(errors, []);
    assert.equal(await file_viewer.end(), 0, "it ends well while somebody looks");
  } finally {
    await file_viewer.end();
  }
});

test("a map that cannot be made as it was is told", async () => {
  writeFileSync("tiles.textproto", "service { max_archive_mb: 0 }\n");
  output("splinemap", ["build", "office.lcmlog", "tiles.splinemap", ...kSensors, "--name", "tiles",
                       "--config", "tiles.textproto"]);
  output("splinemap", ["merge", "past.splinemap", "tiles.splinemap", "--out", "both.splinemap"]);
  for (const [map, hasSlider] of [["tiles.splinemap", false], ["both.splinemap", true]]) {
    const file_viewer = new ViewerProgram({ flags: [map] });
    try {
      const shown = await open(await file_viewer.url());
      await untilStatus(shown, "File");
      assert.equal(await shown.locator("#times").isVisible(), hasSlider, map);
      if (!hasSlider) continue;
      await shown.locator("#time").fill("500");
      await until("the page says why", async () => (await text(shown, "banner")).includes("keeps no scans of it"));
      assert.match(await text(shown, "banner"), /cannot be made.*layer tiles.*the map of now\./s);
      await picture(shown, "past_cannot_be_made");
      await shown.locator("#time-now").click();
      await until("nothing is wrong", async () => !(await shown.locator("#banner").isVisible()));
      await shown.context().close();
    } finally {
      await file_viewer.end();
    }
  }
});

test("a robot is drawn where its daemon places it", async () => {
  await daemon.end();
  daemon = new Program("splinemapd", "--map", "placed.splinemap", "--name", "robot", "--frame", "30,-5,90", ...kSensors);
  const placed_viewer = new ViewerProgram({ flags: kSensors });
  try {
    const shown = await open(await placed_viewer.url());
    const drive = new Program("lcm-logplayer", "-s", "20", "office.lcmlog");
    await until("hits of the scan", async () => (await overlayPixels(shown, kScan)) > 50);
    await drive.ended;
    output("splinemap", ["snapshot", "office_placed.splinemap"]);
    const hits = await shown.evaluate(() => new Promise((resolve) => {
      const socket = new WebSocket(new URL("live", location.href.replace("http", "ws")));
      socket.binaryType = "arraybuffer";
      socket.onmessage = ({ data }) => {
        const length = new DataView(data).getUint32(0, true);
        const { scans } = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
        const { points_m } = scans[0];
        resolve(Array.from({ length: points_m.length / 2 }, (_, k) => ({ x_m: points_m[2 * k], y_m: points_m[2 * k + 1] })));
      };
    }));
    const samples = query("office_placed.splinemap", hits);
    const near = samples.filter(({ log_odds, known }) => known && log_odds > -4).length;
    assert.ok(hits.length > 100 && near > 0.9 * hits.length, `${near} of ${hits.length} hits are at walls`);
    await picture(shown, "placed");
  } finally {
    await placed_viewer.end();
  }
});
