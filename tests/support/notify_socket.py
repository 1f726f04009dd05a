#!/usr/bin/env python3
"""notify_socket.py SOCKET: prints what services say to systemd there, a message a line."""
import os
import socket
import sys

os.makedirs(os.path.dirname(os.path.abspath(sys.argv[1])), exist_ok=True)
receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
receiver.bind(sys.argv[1])
while True:
    print(receiver.recv(65536).decode().replace("\n", " | "), flush=True)
