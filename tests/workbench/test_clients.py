"""Connections that nobody uses make room for those that are used."""

import socket
from contextlib import contextmanager

import pytest

from bms_gateway.workbench.clients import MOST, Clients


@contextmanager
def pairs(count):
    made = [socket.socketpair() for _ in range(count)]
    for _, theirs in made:
        theirs.settimeout(0.0)
    try:
        yield made
    finally:
        for pair in made:
            for one in pair:
                one.close()


def cut(theirs):
    """Whether the other end was shut."""
    try:
        return theirs.recv(1) == b""
    except BlockingIOError:
        return False


def filled(made):
    clients = Clients()
    assert all(clients.come(ours) for ours, _ in made[:MOST])
    return clients


def test_a_browser_has_room_for_ten_pages():
    assert MOST == 64


def test_one_more_takes_the_place_of_the_one_that_has_been_idle_longest():
    with pairs(MOST + 2) as made:
        clients = filled(made)
        assert not any(cut(theirs) for _, theirs in made)
        clients.answer(made[0][0], begins=True)
        clients.answer(made[0][0], begins=False)  # so another one has been idle for longer
        assert clients.come(made[MOST][0])
        assert clients.come(made[MOST + 1][0])
        assert [cut(theirs) for _, theirs in made] == [False, True, True, *[False] * (MOST - 1)]


def test_one_that_is_being_answered_stays_and_without_another_there_is_no_room():
    with pairs(MOST + 1) as made:
        clients = filled(made)
        for ours, _ in made[:MOST]:
            clients.answer(ours, begins=True)
        assert not clients.come(made[MOST][0])
        clients.answer(made[3][0], begins=False)
        assert clients.come(made[MOST][0])
        assert [k for k, (_, theirs) in enumerate(made) if cut(theirs)] == [3]


def test_one_that_goes_makes_room_and_is_not_known_any_more():
    with pairs(MOST + 1) as made:
        clients = filled(made)
        clients.go(made[5][0])
        clients.answer(made[5][0], begins=True)
        assert clients.come(made[MOST][0])
        clients.go(made[5][0])  # once more, as after it was cut
        assert not any(cut(theirs) for _, theirs in made)


@pytest.mark.parametrize("gone", ["closed", "by the other side"])
def test_one_that_has_gone_by_itself_makes_room_all_the_same(gone):
    with pairs(MOST + 1) as made:
        clients = filled(made)
        made[0][0 if gone == "closed" else 1].close()
        assert clients.come(made[MOST][0])
