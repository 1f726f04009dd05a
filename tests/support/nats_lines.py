"""nats_lines.py HOST PORT CREDENTIALS LINE..: says lines to a NATS server as the credentials, as no
client library would, and prints what it answers until it is quiet. | ends a line, too."""
import json
import socket
import ssl
import sys

host, port, credentials = sys.argv[1:4]
plain = socket.create_connection((host, int(port)), timeout=5)
plain.settimeout(0.3)
try:
    plain.recv(65536)  # who the server is, which it tells routes later
except TimeoutError:
    pass
plain.settimeout(5)
context = ssl.create_default_context(cafile=credentials + "/ca.pem")
context.load_cert_chain(credentials + "/own.pem", credentials + "/own.key")
server = context.wrap_socket(plain, server_hostname=host)
options = {"verbose": False, "pedantic": False, "headers": True, "no_responders": True}
lines = [f"CONNECT {json.dumps(options)}", *sys.argv[4:], "PING"]
# At once: a server may close after the first.
server.sendall("".join(line.replace("|", "\r\n") + "\r\n" for line in lines).encode())
said = b""
server.settimeout(0.3)
try:
    while part := server.recv(65536):
        said += part
except TimeoutError:
    pass
print(said.decode(errors="replace"))
