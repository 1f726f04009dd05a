"""Cases of tests/integration/viewer_access.sh, which makes room.splinemap, cert.pem and key.pem."""
import json, math, resource, select, socket, struct, subprocess, sys, time, unittest

from michigan.pose_xyt_t import pose_xyt_t
from web_client import Reader, WebSocket, answer, ask, connect, post, status_of, trusting

TOKEN = "0123456789abcdef0123456789abcdef"
QUERY = "/api/query?x=3&y=2"
PICTURE = "/map.png?bbox=-5,-5,5,9&px=100"
DATA = [QUERY, PICTURE, "/metrics", "/api/ray?x=1&y=1&bearing_deg=0", "/tiles/20/524288/524288.png"]
MAX_RSS_MB = 150


def say(text):
    print("\nviewer_access:", text, file=sys.stderr)


class Viewer:
    """A splinemap-viewer, of room.splinemap where nothing else is told."""

    def __init__(self, *flags, of=("room.splinemap",)):
        self.process = subprocess.Popen(["splinemap-viewer", *of, "--port", "0", *flags],
                                        stderr=subprocess.PIPE, text=True)
        line = self.process.stderr.readline()
        assert line.startswith("The map is at "), line
        self.url = line.split()[4]
        self.port = int(self.url.split(":")[2].split("/")[0])

    def rss_mb(self):
        with open(f"/proc/{self.process.pid}/status") as status:
            return next(int(line.split()[1]) for line in status if line.startswith("VmRSS")) / 1024

    def end(self):
        self.process.terminate()
        status = self.process.wait(20)
        self.process.stderr.close()
        assert status == 0, f"exit status {status}"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end()


def refused(*flags):
    """The exit status and the words of a viewer that does not start."""
    ended = subprocess.run(["splinemap-viewer", "room.splinemap", *flags], stderr=subprocess.PIPE, text=True,
                           timeout=20)
    return ended.returncode, ended.stderr


def write_token():
    with open("token", "w") as file:
        file.write(TOKEN + "\n")
    return "token"


class WhoMayAsk(unittest.TestCase):
    def refuses_live(self, viewer, status, target="/live", headers={}):
        with self.assertRaises(ConnectionRefusedError) as refusal:
            WebSocket(viewer.port, target, headers)
        self.assertEqual(refusal.exception.args[0], status)

    def test_without_the_token_there_is_no_data(self):
        with Viewer("--token-file", write_token()) as viewer:
            self.assertTrue(viewer.url.endswith("?token=" + TOKEN))
            for told in ("", "&token=", "&token=" + TOKEN[:-1], "&token=" + TOKEN + "0", "&token=" + "0" * 32):
                for target in DATA:
                    target += told if "?" in target else told.replace("&", "?")
                    status, headers, body = ask(viewer.port, target)
                    self.assertEqual((status, headers["www-authenticate"]), (401, "Bearer"), target)
                    self.assertEqual(list(json.loads(body)), ["error"])
                self.refuses_live(viewer, 401, "/live" + told.replace("&", "?"))
            for words in ("Bearer 0", "Bearer ", TOKEN, "Basic " + TOKEN):
                self.assertEqual(status_of(viewer.port, QUERY, headers={"Authorization": words}), 401)
            for command in ("/api/goal", "/api/mute"):
                self.assertEqual(post(viewer.port, command, {})[0], 401)
            for page in ("/", "/viewer.js", "/viewer.css", "/healthz"):
                status, _, body = ask(viewer.port, page)
                self.assertEqual(status, 200)
                self.assertNotIn(TOKEN.encode(), body)
            self.assertEqual(status_of(viewer.port, QUERY, headers={"Authorization": "Bearer " + TOKEN}), 200)
            for target in DATA[:3]:
                target += "&" if "?" in target else "?"
                self.assertEqual(status_of(viewer.port, target + "token=" + TOKEN), 200)
            with WebSocket(viewer.port, "/live?token=" + TOKEN) as page:
                self.assertGreater(page.see(), 20)

    def test_pages_of_other_sites_are_refused(self):
        with Viewer() as viewer:
            own = f"http://127.0.0.1:{viewer.port}"
            for origin in ("http://evil.example", "null", own + "0", own.replace("127", "128"), "http://localhost"):
                self.refuses_live(viewer, 403, headers={"Origin": origin})
                self.assertEqual(post(viewer.port, "/api/goal", {}, Origin=origin)[0], 403)
                self.assertEqual(status_of(viewer.port, QUERY, headers={"Origin": origin}), 403)
            with WebSocket(viewer.port, headers={"Origin": own}) as page:
                self.assertGreater(page.see(), 20)
            # What a form can send, which browsers do not ask about first.
            for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data"):
                headers = {"Content-Type": kind}
                status, _, body = ask(viewer.port, "/api/goal", "POST", headers, b'{"x_m": 1}')
                self.assertEqual(status, 400)
                self.assertIn("Content-Type", json.loads(body)["error"])
            _, headers, _ = ask(viewer.port, "/")
            self.assertIn("default-src 'self'", headers["content-security-policy"])
            self.assertIn("frame-ancestors 'none'", headers["content-security-policy"])
            self.assertNotIn("access-control-allow-origin", headers)

    def test_a_name_that_was_rebound_to_this_computer_is_refused(self):
        with Viewer() as viewer:
            for host in ("evil.example", f"evil.example:{viewer.port}", "127.0.0.1.evil.example", "localhost.evil",
                         "10.0.0.1", "", "[::1"):
                for target in DATA:
                    self.assertEqual(status_of(viewer.port, target, headers={"Host": host}), 403, host)
                headers = {"Host": host, "Origin": "http://" + host}
                self.refuses_live(viewer, 403, headers=headers)
                self.assertEqual(post(viewer.port, "/api/goal", {}, **headers)[0], 403)
            for host in (f"localhost:{viewer.port}", f"127.0.0.1:{viewer.port}", f"[::1]:{viewer.port}"):
                self.assertEqual(status_of(viewer.port, QUERY, headers={"Host": host}), 200)

    def test_what_other_computers_reach_needs_a_token_and_tls(self):
        write_token()
        status, words = refused("--listen", "0.0.0.0", "--port", "0")
        self.assertEqual(status, 2)
        self.assertIn("--token-file", words)
        status, words = refused("--listen", "0.0.0.0", "--port", "0", "--token-file", "token")
        self.assertEqual(status, 2)
        self.assertIn("--certificate and --key", words)
        status, words = refused("--listen", "somewhere", "--port", "0")
        self.assertEqual(status, 2)
        self.assertIn("somewhere is no address", words)
        with open("short", "w") as file:
            file.write("secret\n")
        status, words = refused("--token-file", "short")
        self.assertEqual(status, 2)
        self.assertNotIn("secret", words)
        self.assertEqual(refused("--token-file", "nothing")[0], 2)
        for certificate, key in (("token", "key.pem"), ("cert.pem", "token")):
            status, words = refused("--port", "0", "--certificate", certificate, "--key", key)
            self.assertEqual(status, 2)
            self.assertIn("token is no", words)
        self.assertEqual(refused("--port", "0", "--certificate", "cert.pem")[0], 2)

    def test_a_port_that_is_taken_is_told(self):
        with Viewer() as viewer:
            status, words = refused("--port", str(viewer.port))
            self.assertEqual(status, 1)
            self.assertIn(f"cannot listen on 127.0.0.1 port {viewer.port}: Address already in use", words)
            self.assertIn("--port", words)

    def test_tls_with_a_certificate_of_ones_own(self):
        flags = ("--listen", "0.0.0.0", "--token-file", write_token(), "--certificate", "cert.pem", "--key", "key.pem")
        with Viewer(*flags) as viewer:
            self.assertTrue(viewer.url.startswith("https://"))
            tls = trusting("cert.pem")
            self.assertEqual(status_of(viewer.port, QUERY, tls=tls), 401)
            self.assertEqual(status_of(viewer.port, QUERY + "&token=" + TOKEN, tls=tls), 200)
            # Whatever they call it.
            headers = {"Host": "robot.example"}
            self.assertEqual(status_of(viewer.port, QUERY + "&token=" + TOKEN, headers=headers, tls=tls), 200)
            origin = {"Origin": f"https://127.0.0.1:{viewer.port}"}
            with WebSocket(viewer.port, "/live?token=" + TOKEN, origin, tls) as page:
                self.assertGreater(page.see(), 20)
            with self.assertRaises((EOFError, ConnectionError)):  # in the open
                ask(viewer.port, QUERY + "&token=" + TOKEN)


class WhatComesIn(unittest.TestCase):
    def raw(self, viewer, data):
        """The status of the answer to these bytes, or None where there is none."""
        with connect(viewer.port) as connection:
            try:
                connection.sendall(data)
                return answer(Reader(connection))[0]
            except (EOFError, ConnectionError):
                return None

    def test_there_is_no_way_to_files(self):
        with Viewer() as viewer:
            for path in ("/../../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd", "/viewer.js/../../key.pem",
                         "/..%2fkey.pem", "/..\\key.pem", "/key.pem", "/room.splinemap", "/tiles/../key.pem",
                         "/tiles/0/0/../../key.pem", "/index.html%00.png", "/viewer.css%00"):
                self.assertEqual(status_of(viewer.port, path), 404, path)
            for target in ("key.pem", "http://127.0.0.1/../key.pem", "*"):
                self.assertEqual(status_of(viewer.port, target), 400, target)

    def test_too_much_is_refused(self):
        with Viewer() as viewer:
            host = f"Host: 127.0.0.1:{viewer.port}\r\n".encode()
            get = b"GET / HTTP/1.1\r\n" + host
            self.assertEqual(self.raw(viewer, get + b"\r\n"), 200)
            for data in (get + b"X: " + b"x" * (1 << 20) + b"\r\n\r\n", get + b"X: 1\r\n" * 50_000 + b"\r\n",
                         b"GET /" + b"x" * 100_000 + b" HTTP/1.1\r\n" + host + b"\r\n", b"\0" * 10_000,
                         b"GET / HTTP/9.9\r\n" + host + b"\r\n", b"\x16\x03\x01\x02\x00\x01" + b"x" * 600):
                self.assertIn(self.raw(viewer, data), (None, 400), data[:40])
            command = b"POST /api/goal HTTP/1.1\r\nContent-Type: application/json\r\n" + host
            for size in (5_000, 1 << 20, 1 << 62):
                head = command + b"Content-Length: %d\r\n\r\n" % size
                self.assertIn(self.raw(viewer, head + b"x" * min(size, 1 << 20)), (None, 400), size)
            chunks = command + b"Transfer-Encoding: chunked\r\n\r\n" + b"400\r\n" + b"x" * 0x400 + b"\r\n"
            self.assertIn(self.raw(viewer, chunks * 10), (None, 400))
            for query in ("x=nan&y=1", "x=1", "x=1&x=2&y=1", "x=1e999&y=0", "x=%zz&y=1", "x=%001&y=1"):
                self.assertEqual(status_of(viewer.port, "/api/query?" + query), 400, query)
            for target in ("/map.png?bbox=0,0,1,1&px=1e9", "/map.png?bbox=0,0,1,1e8&px=4096",
                           "/map.png?bbox=1,1,0,0&px=9", "/map.png?bbox=0,0,nan,1&px=9", "/map.png?px=9",
                           "/api/check?x0=0&y0=0&x1=1e6&y1=1e6&radius=1e6"):
                self.assertEqual(status_of(viewer.port, target), 400, target)
            for target in ("/tiles/99/0/0.png", "/tiles/2/4/0.png", "/tiles/2/-1/0.png", "/tiles/x/0/0.png", "/api/nothing"):
                self.assertEqual(status_of(viewer.port, target), 404, target)
            self.assertEqual(status_of(viewer.port, "/tiles/0/0/0.png"), 200)
            self.assertEqual(status_of(viewer.port, QUERY, "DELETE"), 400)
            self.assertLess(viewer.rss_mb(), MAX_RSS_MB)

    def test_messages_that_cannot_be_end_their_page_alone(self):
        view = {"x0_m": 0, "y0_m": 0, "x1_m": 1, "y1_m": 1, "level": 0, "surfaces": ["sum"]}
        deep = 2_000
        hostile = [b'{"view":' + b"[" * deep + b"]" * deep + b"}", b'{"view":' + b'{"a":' * deep + b"1" + b"}" * (deep + 1), b"", b"x", b"[]", b"7", b'{"view": 1}', b'{"view": {}}', b'{"ack": "1"}',
                   b"\xff\xfe", b'{"view": null}']
        for change in ({"level": -1}, {"level": 99}, {"level": 1e300}, {"x0_m": 2}, {"x1_m": None}, {"x0_m": "1"},
                       {"surfaces": "sum"}, {"surfaces": ["sum"] * 33}, {"surfaces": [1]}):
            hostile.append(json.dumps({"view": {**view, **change}}).encode())
        with Viewer() as viewer, WebSocket(viewer.port) as established:
            for message in hostile:
                with WebSocket(viewer.port) as page:
                    page.send(message)
                    self.assertIn(page.end(), (1002, 1007, 1008), message[:60])
            for unusual in ({"x0_m": -1e300, "y0_m": -1e300, "x1_m": 1e300, "y1_m": 1e300}, {"surfaces": ["no such", "a[b[c[d"]},
                            {"surfaces": []}, {"surfaces": ["sum"] * 32, "level": 8}):
                established.see(**unusual)
            for ack in (-1, 1 << 62):
                established.send(json.dumps({"ack": ack}).encode())
            self.assertGreater(established.see(), 20)
            with WebSocket(viewer.port) as page:
                page.send(b"x" * 20_000)
                self.assertEqual(page.end(), 1009)
            with WebSocket(viewer.port) as page:
                page.send(b"x", claimed=1 << 62)
                self.assertEqual(page.end(), 1009)
            with WebSocket(viewer.port) as page:
                page.send(b"x", is_masked=False)
                self.assertEqual(page.end(), 1002)
            # A page that acknowledges nothing is sent nothing more.
            with WebSocket(viewer.port) as page:
                self.assertEqual(page.message()[0], WebSocket.BINARY)
                for _ in range(1000):
                    page.send(json.dumps({"view": view}).encode())
                page.send(b"", WebSocket.PING)
                self.assertEqual(page.message()[0], 10)
            established.see()
            self.assertLess(viewer.rss_mb(), MAX_RSS_MB)

    def test_more_pages_than_there_is_room_for(self):
        with Viewer() as viewer:
            pages = [WebSocket(viewer.port) for _ in range(64)]
            self.addCleanup(lambda: [page.close() for page in pages])
            with WebSocket(viewer.port) as page:
                self.assertEqual(page.end(), 1013)
            self.assertGreater(pages[0].see(), 20)
            self.assertEqual(status_of(viewer.port, QUERY), 200)
            pages[1].close()
            self.await_page(viewer)

    def await_page(self, viewer):
        for _ in range(100):
            with WebSocket(viewer.port) as page:
                try:
                    return self.assertGreater(page.see(), 20)
                except EOFError:
                    time.sleep(0.05)
        self.fail("no page can be opened")

    def test_a_thousand_connections_at_once(self):
        resource.setrlimit(resource.RLIMIT_NOFILE, (4096, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
        with Viewer() as viewer, WebSocket(viewer.port) as established:
            established.see()
            crowd, slowest_s = [], 0
            for n in range(1000):
                connection = connect(viewer.port)
                crowd.append(connection)
                try:
                    connection.sendall(b"GET / HTTP/1.1\r\nX: ")
                except ConnectionError:
                    pass  # one too many
                if n % 100 == 99:
                    begin = time.monotonic()
                    established.see()
                    slowest_s = max(slowest_s, time.monotonic() - begin)
            rss_mb = viewer.rss_mb()
            for connection in crowd:
                connection.close()
            self.await_page(viewer)
            self.assertLess(slowest_s, 2)
            self.assertLess(rss_mb, MAX_RSS_MB)
            say(f"1,000 connections: {rss_mb:.0f} MB, an open page is answered in {1000 * slowest_s:.0f} ms or less")

    def test_who_sends_a_byte_a_second_is_ended_and_keeps_nobody_waiting(self):
        with Viewer() as viewer:
            begin, slowest_s, next_byte = time.monotonic(), 0, 0
            slow = [connect(viewer.port) for _ in range(50)]
            while slow:
                self.assertLess(time.monotonic() - begin, 15, f"{len(slow)} are still there")
                if time.monotonic() >= next_byte:
                    next_byte = time.monotonic() + 1
                    for connection in slow:
                        try:
                            connection.send(b"G")
                        except ConnectionError:
                            pass
                asked = time.monotonic()
                self.assertEqual(status_of(viewer.port, QUERY), 200)
                slowest_s = max(slowest_s, time.monotonic() - asked)
                for connection in select.select(slow, [], [], 0.2)[0]:
                    slow.remove(connection)
                    connection.close()
            self.assertLess(slowest_s, 2)
            say(f"slow requests: ended after {time.monotonic() - begin:.0f} s, others answered in "
                f"{1000 * slowest_s:.0f} ms or less")


class Layers(unittest.TestCase):
    def test_a_layer_that_is_placed_is_shown_where_it_is_in_the_map(self):
        shown = []
        for place in ["0 0 0", "1 -0.5 0", "1.01 -0.5 40"]:
            command = f"splinemap layer place room.splinemap robot {place} --out placed.splinemap --force"
            subprocess.run(command.split(), check=True, stderr=subprocess.DEVNULL)
            with Viewer(of=("placed.splinemap",)) as viewer, WebSocket(viewer.port) as page:
                layer, = page.frame()["layers"]
                self.assertEqual(layer["is_approximate"], place.endswith("40"))
                # Tiles and the bytes of each; the layer is all of the sum.
                seen = [sorted(row[1:4] for row in page.tiles(surfaces=[name])) for name in ["sum", layer["key"]]]
            self.assertEqual(*seen)
            self.assertGreater(len(seen[0]), 20)
            shown.append(seen[0])
        self.assertNotEqual(shown[0], shown[1])
        self.assertNotEqual(shown[1], shown[2])


class Commands(unittest.TestCase):
    """Beside a daemon with a layer, on the bus."""

    def setUp(self):
        subprocess.run(["cp", "room.splinemap", "live.splinemap"], check=True)
        self.start("splinemapd", "--map", "live.splinemap", "--no-sensors", "--name", "robot")

    def start(self, *command):
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        self.addCleanup(process.wait)
        self.addCleanup(process.terminate)
        return process

    def layer(self):
        ended = subprocess.run(["splinemap", "layers", "--live", "--json"], stdout=subprocess.PIPE, text=True)
        daemons = json.loads(ended.stdout) if ended.returncode == 0 else []
        return daemons[0]["layers"][0] if daemons and daemons[0]["layers"] else None

    def await_true(self, condition):
        deadline = time.monotonic() + 20
        while not condition():
            self.assertLess(time.monotonic(), deadline, "did not come true in 20 s")
            time.sleep(0.1)

    def key_of_layer(self, viewer):
        with WebSocket(viewer.port) as page:
            while True:
                layers = page.frame().get("layers")
                if layers:
                    return layers[0]["key"]

    def test_commands_are_refused_where_they_are_not_allowed(self):
        self.await_true(self.layer)
        with Viewer(of=()) as viewer:
            key = self.key_of_layer(viewer)
            for command, value in (("goal", {"x_m": 1, "y_m": 2, "yaw_rad": 0}), ("mute", {"layer": key, "muted": True})):
                status, _, body = post(viewer.port, "/api/" + command, value)
                self.assertEqual(status, 403)
                self.assertIn("--allow-commands", json.loads(body)["error"])
            self.assertFalse(self.layer()["muted"])

    def test_goals_and_mutes_reach_the_bus(self):
        logger = self.start("lcm-logger", "--quiet", "--force", "goals.lcmlog", "-c", "PLACE")
        self.await_true(self.layer)
        with Viewer("--allow-commands", "--goal-channel", "PLACE", of=()) as viewer:
            for wrong in ({}, [], 7, {"x_m": 1, "y_m": 2}, {"x_m": "1", "y_m": 2, "yaw_rad": 0},
                          {"x_m": None, "y_m": 2, "yaw_rad": 0}):
                self.assertEqual(post(viewer.port, "/api/goal", wrong)[0], 400, wrong)
            self.assertEqual(ask(viewer.port, "/api/goal", "POST", {"Content-Type": "application/json"},
                                 b'{"x_m": 1e999, "y_m": 2, "yaw_rad": 0}')[0], 400)
            self.assertEqual(post(viewer.port, "/api/goal", {"x_m": 1.5, "y_m": -2.25, "yaw_rad": 0.5})[0], 200)
            key = self.key_of_layer(viewer)
            for wrong in ({}, {"layer": key}, {"layer": key, "muted": 1}, {"layer": 1, "muted": True}):
                self.assertEqual(post(viewer.port, "/api/mute", wrong)[0], 400, wrong)
            self.assertEqual(post(viewer.port, "/api/mute", {"layer": "nobody@0", "muted": True})[0], 404)
            is_known = lambda: json.loads(ask(viewer.port, QUERY)[2])["known"]
            self.await_true(is_known)
            for muted in (True, False):
                mute = {"layer": key, "muted": muted}
                self.await_true(lambda: post(viewer.port, "/api/mute", mute)[0] == 200)  # 404 before it is heard
                self.await_true(lambda: self.layer()["muted"] == muted)
                self.await_true(lambda: is_known() != muted)
        logger.send_signal(2)
        logger.wait(20)
        goals = self.goals("goals.lcmlog")
        self.assertEqual([(goal.x, goal.y, goal.theta) for goal in goals], [(1.5, -2.25, 0.5)])
        self.assertLess(abs(goals[0].utime - 1e6 * time.time()), 60e6)

    def goals(self, path):
        with open(path, "rb") as log:
            data = log.read()
        goals, at = [], 0
        while at < len(data):
            name_size, size = struct.unpack_from(">II", data, at + 20)
            message = data[at + 28 + name_size:at + 28 + name_size + size]
            goals.append(pose_xyt_t.decode(message))
            at += 28 + name_size + size
        return goals
