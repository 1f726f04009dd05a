"""HTTP and WebSocket by hand, so that what no library would send can be sent."""
import base64, json, os, socket, ssl, struct


class Reader:
    """What comes from a socket, until its end."""

    def __init__(self, connection):
        self.connection, self.buffer = connection, b""

    def up_to(self, end):
        while end not in self.buffer:
            self._more()
        text, self.buffer = self.buffer.split(end, 1)
        return text

    def bytes(self, count):
        while len(self.buffer) < count:
            self._more()
        taken, self.buffer = self.buffer[:count], self.buffer[count:]
        return taken

    def _more(self):
        more = self.connection.recv(1 << 16)
        if not more:
            raise EOFError
        self.buffer += more


def connect(port, tls=None):
    connection = socket.create_connection(("127.0.0.1", port), timeout=20)
    return tls.wrap_socket(connection, server_hostname="127.0.0.1") if tls else connection


def answer(reader):
    """Status, headers and body of the next answer."""
    lines = reader.up_to(b"\r\n\r\n").decode().split("\r\n")
    headers = {name.lower(): value for name, value in (line.split(": ", 1) for line in lines[1:])}
    return int(lines[0].split()[1]), headers, reader.bytes(int(headers.get("content-length", 0)))


def ask(port, target, method="GET", headers={}, body=b"", tls=None):
    """As answer(), of a request on a connection of its own."""
    all_headers = {"Host": f"127.0.0.1:{port}", "Connection": "close", **headers}
    if body or method == "POST":
        all_headers["Content-Length"] = len(body)
    lines = [f"{method} {target} HTTP/1.1"] + [f"{name}: {value}" for name, value in all_headers.items()]
    with connect(port, tls) as connection:
        connection.sendall("\r\n".join(lines).encode() + b"\r\n\r\n" + body)
        return answer(Reader(connection))


def status_of(*arguments, **named):
    return ask(*arguments, **named)[0]


def post(port, target, value, **headers):
    return ask(port, target, "POST", {"Content-Type": "application/json", **headers}, json.dumps(value).encode())


class WebSocket:
    """An open page. Raises ConnectionRefusedError, with the status, where the server wants none."""

    TEXT, BINARY, CLOSE, PING = 1, 2, 8, 9

    def __init__(self, port, target="/live", headers={}, tls=None):
        self.connection = connect(port, tls)
        key = base64.b64encode(os.urandom(16)).decode()
        upgrade = {"Host": f"127.0.0.1:{port}", "Upgrade": "websocket", "Connection": "Upgrade",
                   "Sec-WebSocket-Key": key, "Sec-WebSocket-Version": 13, **headers}
        lines = [f"GET {target} HTTP/1.1"] + [f"{name}: {value}" for name, value in upgrade.items()]
        self.connection.sendall("\r\n".join(lines).encode() + b"\r\n\r\n")
        self.reader = Reader(self.connection)
        status = int(self.reader.up_to(b"\r\n\r\n").split()[1])
        if status != 101:
            self.close()
            raise ConnectionRefusedError(status)

    def close(self):
        self.connection.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def send(self, payload, code=TEXT, claimed=None, is_masked=True):
        size = len(payload) if claimed is None else claimed
        masked_bit = 0x80 if is_masked else 0
        if size < 126:
            header = struct.pack(">BB", 0x80 | code, masked_bit | size)
        elif size < 1 << 16:
            header = struct.pack(">BBH", 0x80 | code, masked_bit | 126, size)
        else:
            header = struct.pack(">BBQ", 0x80 | code, masked_bit | 127, size)
        mask = os.urandom(4) if is_masked else b""
        masked = bytes(byte ^ mask[k % 4] for k, byte in enumerate(payload)) if is_masked else payload
        self.connection.sendall(header + mask + masked)

    def message(self):
        """Code and payload of the next."""
        code, payload = self._fragment()
        while not code & 0x80:
            last, more = self._fragment()
            code, payload = code | last & 0x80, payload + more
        return code & 15, payload

    def _fragment(self):
        code, size = self.reader.bytes(2)
        if size == 126:
            size, = struct.unpack(">H", self.reader.bytes(2))
        elif size == 127:
            size, = struct.unpack(">Q", self.reader.bytes(8))
        return code, self.reader.bytes(size)

    def frame(self):
        """The JSON part of the next frame, acknowledged."""
        code, payload = self.message()
        if code == self.CLOSE:
            raise EOFError(payload)
        size, = struct.unpack_from("<I", payload)
        value = json.loads(payload[4:4 + size])
        self.send(json.dumps({"ack": value["frame"]}).encode())
        return value

    def see(self, **changes):
        """As tiles(); how many there were."""
        return len(self.tiles(**changes))

    def tiles(self, **changes):
        """Asks for a view; the rows of its tiles when all are there."""
        view = {"x0_m": -5, "y0_m": -5, "x1_m": 5, "y1_m": 9, "level": 0, "surfaces": ["sum"], **changes}
        self.send(json.dumps({"view": view}).encode())
        rows = []
        while True:
            tiles = self.frame().get("tiles")
            rows += tiles["list"] if tiles else []
            if tiles and tiles["is_complete"]:
                return rows

    def end(self):
        """The code of the server's close, or None where it just closed."""
        try:
            while True:
                code, payload = self.message()
                if code == self.CLOSE:
                    return struct.unpack_from(">H", payload)[0]
        except (EOFError, ConnectionError):
            return None


def trusting(certificate):
    return ssl.create_default_context(cafile=certificate)
