"""Requests, tries and refusals, without a service."""

import asyncio
import json
import pickle

import httpx
import numpy as np
import pytest

from shapelex import AsyncClient, Busy, Client, Conflict, InvalidInput, NotFound, Problem, Unreachable
from shapelex._reply import Events, form_body, pairs
from shapelex._sync_transport import pause_before

BUSY = {"type": "urn:shapelex:problem:overloaded", "code": "overloaded", "title": "Overloaded", "status": 503}
REFUSED = {
    "type": "urn:shapelex:problem:invalid-input",
    "code": "invalid-input",
    "title": "Invalid input",
    "status": 422,
    "detail": "The input is invalid.",
    "errors": [{"pointer": "/shapes/3/points", "index": 3, "detail": "expected at least 3 points, got 1"}],
    "request_id": "req-1",
}


def problem_of(document, **headers):
    body = json.dumps({"detail": "Try later.", "errors": [], **document})
    return httpx.Response(
        document["status"], text=body, headers={"content-type": "application/problem+json", **headers}
    )


class Answers:
    """A transport that gives one answer after the other, and remembers the requests."""

    def __init__(self, *answers):
        self.answers, self.requests = list(answers), []

    def __call__(self, request):
        self.requests.append(request)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def client(self, **options):
        return Client("http://service", http=httpx.Client(transport=httpx.MockTransport(self)), **options)


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch):
    monkeypatch.setattr("shapelex._sync_transport.time.sleep", lambda seconds: None)


def test_busy_services_are_asked_again_with_the_same_key():
    answers = Answers(problem_of(BUSY, **{"retry-after": "1"}), problem_of(BUSY), httpx.Response(201, json={"id": "x"}))
    body = {"name": "a", "representation": {"kind": "landmarks", "dimension": 2, "points": 3}}
    assert answers.client().calls.create_cohort(body).status == 201
    keys = {request.headers["idempotency-key"] for request in answers.requests}
    assert len(answers.requests) == 3 and len(keys) == 1 and len(keys.pop()) == 32


def test_two_requests_have_two_keys():
    answers = Answers(*(httpx.Response(201, json={}) for _ in range(2)))
    client = answers.client()
    for _ in range(2):
        client.calls.create_cohort({"name": "a"})
    assert answers.requests[0].headers["idempotency-key"] != answers.requests[1].headers["idempotency-key"]


def test_a_lost_answer_is_asked_for_again_where_that_is_safe():
    lost = httpx.ReadError("connection reset")
    answers = Answers(lost, httpx.Response(200, json={"version": "0.1.0"}))
    assert answers.client().version() == "0.1.0"
    # A key is made anew by every request, and this operation takes no Idempotency-Key.
    answers = Answers(lost)
    with pytest.raises(Unreachable) as caught:
        answers.client().calls.create_key({"name": "a", "role": "reader"})
    assert isinstance(caught.value.__cause__, httpx.ReadError) and len(answers.requests) == 1


def test_what_was_not_sent_is_sent_again_in_any_case():
    answers = Answers(httpx.ConnectError("refused"), httpx.Response(201, json={"key": "k"}))
    assert answers.client().calls.create_key({"name": "a", "role": "reader"}).status == 201


def test_tries_end():
    answers = Answers(*(problem_of(BUSY) for _ in range(3)))
    with pytest.raises(Busy):
        answers.client(tries=3).version()
    assert len(answers.requests) == 3
    answers = Answers(*(httpx.ConnectError("refused") for _ in range(2)))
    with pytest.raises(Unreachable, match="GET http://service/v1/version: refused"):
        answers.client(tries=2).version()


def test_what_would_take_too_long_again_is_not_repeated():
    answers = Answers(problem_of({**BUSY, "code": "took-too-long"}))
    with pytest.raises(Busy):
        answers.client().version()
    assert len(answers.requests) == 1


def test_refusals_carry_the_words_of_the_service():
    answers = Answers(problem_of(REFUSED))
    with pytest.raises(InvalidInput) as caught:
        answers.client().version()
    found = caught.value
    assert (found.type, found.code, found.status) == (REFUSED["type"], "invalid-input", 422)
    assert (found.pointer, found.index, found.cause) == ("/shapes/3/points", 3, "expected at least 3 points, got 1")
    assert found.request_id == "req-1"
    assert "/shapes/3/points (shape 3): expected at least 3 points, got 1" in str(found)
    again = pickle.loads(pickle.dumps(found))
    assert isinstance(again, InvalidInput) and str(again) == str(found) and again.faults == found.faults


@pytest.mark.parametrize(("status", "kind"), [(404, NotFound), (409, Conflict), (412, Conflict), (500, Problem)])
def test_kinds_of_refusals(status, kind):
    with pytest.raises(kind):
        Answers(problem_of({**REFUSED, "status": status})).client().version()


def test_an_answer_of_a_proxy_is_told():
    with pytest.raises(Problem, match="expected a problem document, got <html>"):
        Answers(httpx.Response(500, text="<html>")).client().version()


def test_pauses_grow_and_obey_the_service():
    pauses = [pause_before(attempt, None) for attempt in range(1, 12)]
    assert 0.1 <= pauses[0] <= 0.2 and 0.2 <= pauses[1] <= 0.4 and max(pauses) <= 30
    assert pause_before(1, 3.0) == 3.0 and pause_before(1, 900.0) == 30.0


def test_parameters_of_the_query():
    conditions = {"site": ["zrh", "gva"], "age": {"gte": 30}}
    found = pairs({"labels": conditions, "total": True, "limit": 5, "label": ["a", "b"], "order": None})
    assert ("labels[site]", "zrh") in found and ("labels[site]", "gva") in found
    assert ("labels[age.gte]", "30") in found and ("total", "true") in found
    assert [value for name, value in found if name == "label"] == ["a", "b"]
    assert not [value for name, value in found if name == "order"]


def test_arrays_are_written_as_lists():
    answers = Answers(httpx.Response(200, json={}))
    answers.client().calls.measure({"shapes": [{"points": np.eye(2)}], "representation": {}})
    assert json.loads(answers.requests[0].content)["shapes"] == [{"points": [[1.0, 0.0], [0.0, 1.0]]}]


def test_forms_begin_with_documents(tmp_path):
    picture = tmp_path / "a.png"
    picture.write_bytes(b"\x89PNG")
    body, media_type = form_body({"image": picture, "parameters": {"a": 1}})
    assert media_type.startswith("multipart/form-data; boundary=")
    assert body.index(b'name="parameters"') < body.index(b'name="image"; filename="a.png"')
    assert b'{"a":1}' in body and b"\x89PNG" in body


def test_events_of_lines():
    events = Events()
    lines = ["id: 7", "event: progress", 'data: {"progress": 0.5}', ""]
    found = [event for event in map(events.add, lines) if event]
    assert [(event.kind, event.data, event.id) for event in found] == [("progress", {"progress": 0.5}, "7")]
    assert [event for event in map(events.add, [": still there", "", "data: a", "data: b", ""]) if event][
        0
    ].data == "a\nb"


def test_pages_follow_their_cursor():
    first = httpx.Response(200, json={"items": [{"name": "a"}], "next": "c1"})
    answers = Answers(first, httpx.Response(200, json={"items": [{"name": "b"}], "next": None}))
    assert [cohort.name for cohort in answers.client().cohorts()] == ["a", "b"]
    assert answers.requests[1].url.params["cursor"] == "c1"


def test_a_file_is_streamed_at_every_try(tmp_path):
    file = tmp_path / "plan.dcm"
    file.write_bytes(b"x" * 3_000_000)
    done = {"added": 1, "unchanged": 0, "skipped": 0, "revision": 2, "results": []}
    answers = Answers(problem_of(BUSY), httpx.Response(201, json=done))
    assert answers.client().cohort("c").add(file, on_error="skip", select="heart").added == 1
    for request in answers.requests:
        assert request.read() == b"x" * 3_000_000
        assert request.headers["content-length"] == "3000000"
        assert dict(request.url.params) == {
            "on_error": "skip", "return": "none", "name": "plan.dcm", "select": "heart",
        }  # fmt: skip


def test_keys_come_from_the_environment(monkeypatch):
    monkeypatch.setenv("SHAPELEX_SERVER", "http://elsewhere:1/")
    monkeypatch.setenv("SHAPELEX_KEY", "secret")
    answers = Answers(httpx.Response(200, json={"version": "1"}))
    client = Client(http=httpx.Client(transport=httpx.MockTransport(answers)))
    client.version()
    assert client.url == "http://elsewhere:1" and answers.requests[0].headers["authorization"] == "Bearer secret"
    assert "secret" not in repr(client)


def test_the_asynchronous_half_tries_again_too():
    answers = Answers(httpx.ReadError("reset"), httpx.Response(200, json={"version": "2"}))

    async def ask():
        async with AsyncClient(
            "http://service", http=httpx.AsyncClient(transport=httpx.MockTransport(answers))
        ) as client:
            return await client.version()

    assert asyncio.run(ask()) == "2"
