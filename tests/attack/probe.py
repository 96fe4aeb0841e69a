"""Tiny requests of another client, one every so many milliseconds on a connection that is kept; prints their latencies.

    probe.py HOST PORT SECONDS INTERVAL AUTHORIZATION

A process of its own, so that what the attack computes does not count. Latency counts from the moment at which a request
was due (no coordinated omission).
"""

import http.client
import json
import sys
import time

TINY = {
    "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 6, "generator": {"name": "cubic"}},
    "transformation": "similarity",
    "reference": {"points": [[2, 0], [1, 1], [-1, 1], [-2, 0], [-1, -1], [1, -1]]},
    "shapes": [{"points": [[5, 9], [3, 7], [3, 3], [5, 1], [7, 3], [7, 6]]}],
}


def probe(host, port, seconds, interval, authorization):
    """Latencies in ms and statuses."""
    body, headers = json.dumps(TINY), {"content-type": "application/json"}
    headers |= {"authorization": authorization} if authorization else {}
    connection, latencies, statuses = None, [], {}
    begin, sent = time.monotonic(), 0
    while (due := begin + sent * interval) < begin + seconds:
        time.sleep(max(0.0, due - time.monotonic()))
        sent += 1
        try:
            connection = connection or http.client.HTTPConnection(host, port, timeout=20)
            connection.request("POST", "/v1/project", body, headers)
            answer = connection.getresponse()
            answer.read()
            status = answer.status
        except (OSError, http.client.HTTPException) as error:
            status, connection = type(error).__name__, None
        latencies.append(1e3 * (time.monotonic() - due))
        statuses[str(status)] = statuses.get(str(status), 0) + 1
        # One that waited long has used up the moments of the next: they are not sent late all at once.
        sent = max(sent, int((time.monotonic() - begin) / interval))
    return {"latencies": latencies, "statuses": statuses}


if __name__ == "__main__":
    host, port, seconds, interval = sys.argv[1:5]
    print(json.dumps(probe(host, int(port), float(seconds), float(interval), sys.argv[5] if len(sys.argv) > 5 else "")))
