"""Fixtures of the perception tests."""

import importlib

import pytest
from synthetic_music import RATE, make_music


@pytest.fixture(scope="session", autouse=True)
def one_blas_thread():
    """Small products on several threads are thirty times slower on a busy machine."""
    try:
        threads = importlib.import_module("threadpoolctl")
    except ImportError:
        yield
        return
    with threads.threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture(scope="session")
def music():
    """Three pieces of 40 s."""
    return {f"piece{seed}": make_music(seed, 40.0) for seed in range(3)}


@pytest.fixture(scope="session")
def matcher(music):
    from downbeat.perception.matcher import AlignmentMatcher

    made = AlignmentMatcher()
    for name, samples in music.items():
        made.add(name, samples, RATE)
    made.finish()
    return made
