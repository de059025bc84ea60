"""Servers for a centre that are not ours: S3 (moto) and SFTP (asyncssh), each a process."""

import re
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def s3():
    """An S3 server that is not ours, and a bucket: its address, and what ends it."""
    import boto3

    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", "0"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as server:
        try:
            address = next(found[0] for line in server.stderr if (found := re.search(r"http://[\d.:]+", line)))
            threading.Thread(target=server.stderr.read, daemon=True).start()
            client = boto3.client("s3", endpoint_url=address, region_name="us-east-1")
            client.create_bucket(Bucket="line")
            client.close()
            yield address, server.kill
        finally:
            server.kill()


@contextmanager
def sftp(folder):
    """The address of an SFTP server over a folder."""
    command = [sys.executable, "-m", "tests.support.sftp_server", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]) as server:
        try:
            yield f"sftp://bench@127.0.0.1:{int(server.stdout.readline())}/runs"
        finally:
            server.kill()
