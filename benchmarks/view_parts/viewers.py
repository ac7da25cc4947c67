"""Reads several streams of a page until its server ends; says `reading` first, and in the end how many bytes came.

python viewers.py ADDRESS COUNT
"""

import http.client
import sys
import threading
from urllib.parse import parse_qs, urlsplit


def main() -> None:
    """Read all streams at once."""
    parts, count = urlsplit(sys.argv[1]), int(sys.argv[2])
    token = parse_qs(parts.query)["token"][0]
    read = [0] * count
    begun = threading.Barrier(count + 1)

    def follow(index: int) -> None:
        connection = http.client.HTTPConnection(parts.hostname or "", parts.port)
        connection.request("GET", "/events", headers={"authorization": f"Bearer {token}"})
        answer = connection.getresponse()
        assert answer.status == 200, answer.status
        read[index] += len(answer.read1(1 << 16))
        begun.wait()
        while part := answer.read1(1 << 16):
            read[index] += len(part)

    threads = [threading.Thread(target=follow, args=(index,)) for index in range(count)]
    for thread in threads:
        thread.start()
    begun.wait()
    print("reading", flush=True)
    for thread in threads:
        thread.join()
    print(sum(read))


if __name__ == "__main__":
    main()
