"""The form of a sentence: stop first, then what is forbidden, asked for, stated."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.perception.grounding_rules import Form, clauses

ACTIONS = ["dance", "do the twist", "wave to them", "walk forward", "do that zombie thing again"]
POLITE = ["", "please ", "hey robot ", "okay, ", "and ", "so please "]


@pytest.mark.parametrize(
    "text",
    ["Stop!", "please stop", "okay robot, stop it now", "BASTA", "freeze", "can you stop please",
     "that's enough", "don't move", "do the twist and stop", "salsa. no, stop",
     "I want you to stop", "stand still", "wave, then stop", "arrête", "halt halt halt"],
)  # fmt: skip
def test_stop_words_are_a_stop_wherever_they_stand(text):
    assert Form.STOP in [clause.form for clause in clauses(text)]


@pytest.mark.parametrize(
    "text",
    ["don't stop", "never stop dancing", "the bus stop is over there", "keep going", "non stop",
     "what happens if I say stop", "my brother stopped smoking", "the pause button is broken"],
)  # fmt: skip
def test_words_about_stopping_are_no_stop(text):
    assert Form.STOP not in [clause.form for clause in clauses(text)]


@given(
    st.sampled_from(POLITE),
    st.sampled_from(["don't", "do not", "never", "you must not", "I don't want you to", "Don’t"]),
    st.sampled_from(ACTIONS),
    st.sampled_from(["", " please", " now", ", thank you", "!"]),
)
def test_what_is_forbidden_is_never_a_request(before, no, action, after):
    found = clauses(before + no + " " + action + after)
    assert Form.NEGATED in [clause.form for clause in found]
    assert not {Form.REQUEST, Form.BARE} & {c.form for c in found if action in c.text}


@given(
    st.sampled_from(POLITE),
    st.sampled_from(["can you", "could you please", "why don't you", "let's", "won't you", ""]),
    st.sampled_from(ACTIONS),
    st.sampled_from(["", " please", " for us", "?", " if you don't mind"]),
)
def test_polite_forms_are_requests(before, asks, action, after):
    found = clauses(f"{before}{asks} {action}{after}")
    assert [c.form for c in found if c.form is not Form.BARE] == [Form.REQUEST]


@pytest.mark.parametrize(
    "text",
    ["what is a waltz", "do you like salsa", "I saw a zombie film", "the salsa was too spicy",
     "my hips hurt", "how do you dance", "the robot walked into the wall"],
)  # fmt: skip
def test_questions_and_statements_ask_for_nothing(text):
    assert [clause.form for clause in clauses(text)] == [Form.OTHER]


def test_what_is_rejected_does_not_hide_what_is_wanted():
    found = clauses("do the twist instead of the waltz")
    assert [(c.form, c.text) for c in found] == [
        (Form.REQUEST, "do the twist"),
        (Form.NEGATED, "the waltz"),
    ]


@given(st.text(max_size=200))
def test_any_text_has_clauses(text):
    for clause in clauses(text):
        assert clause.text.strip() == clause.text


@pytest.mark.parametrize("text", ["robot", "hey robot", "ok robot", "dear robot, buddy"])
def test_calling_the_robot_asks_for_nothing(text):
    assert {clause.form for clause in clauses(text)} <= {Form.OTHER}


@pytest.mark.parametrize(
    "text",
    ["salsa? no thanks", "everything but the waltz", "any dance except the twist",
     "ditch the disco", "no more of that robot", "the last thing I want is a waltz",
     "whatever you do, no twist"],
)  # fmt: skip
def test_what_is_refused_is_not_asked_for(text):
    wanted = [c for c in clauses(text) if c.form in (Form.REQUEST, Form.BARE)]
    assert wanted == []


@pytest.mark.parametrize("text", ["pass the salsa", "could you open the door", "send a letter"])
def test_work_of_hands_is_no_dance(text):
    assert {clause.form for clause in clauses(text)} == {Form.OTHER}
