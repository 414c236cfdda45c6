"""From a transcript to a skill, a stop or an answer: on the written set and on what breaks it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from downbeat.perception.errors import PerceptionError
from downbeat.perception.grounding import NOT_BY_VOICE, Grounder, IntentKind
from downbeat.perception.grounding_misheard import Misheard
from downbeat.policies.manifest import load_skills
from downbeat.tools.eval_speech import BUNDLED_UTTERANCES, load_utterances, score

MOVES = (IntentKind.SKILL, IntentKind.AGAIN)


@pytest.fixture(scope="module")
def skills():
    return load_skills()


@pytest.fixture(scope="module")
def model():
    from downbeat.perception.sentence_model import SentenceModel

    try:
        return SentenceModel()
    except PerceptionError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def by_meaning(skills, model):
    """Without what was learned: what skills of somebody else rely on."""
    return Grounder(skills, model)


@pytest.fixture(scope="module", params=["learned", "alike"])
def either(request, skills, by_meaning):
    from downbeat.perception.intent_model import IntentModel

    if request.param == "alike":
        return by_meaning
    intents = IntentModel()
    return Grounder(skills, intents, intents=intents)


@pytest.fixture(scope="module")
def learned(skills, model):
    from downbeat.perception.intent_model import IntentModel

    intents = IntentModel()
    return Grounder(skills, intents, intents=intents)


@pytest.fixture(scope="module")
def by_letters(skills):
    return Grounder(skills, None)


@pytest.mark.parametrize(
    ("half", "top1", "false_triggers"),
    [
        ("tune", 0.97, 0.0),
        ("test", 0.98, 0.01),  # scored once, everything frozen: 241 of 244, 1 of 127
    ],
)
def test_the_written_set_is_understood_as_measured(learned, half, top1, false_triggers):
    rows = [one for one in load_utterances(BUNDLED_UTTERANCES) if one.half == half]
    result = score(learned, rows, "learned")
    assert result.n >= 100
    assert result.top1 >= top1, result.wrong
    assert result.false_triggers <= false_triggers, result.wrong
    assert result.negation_errors == 0, result.wrong


@pytest.mark.parametrize(
    ("text", "skill"),
    [
        ("ok so what i want is a waltz because it is our wedding", "waltz"),
        ("that was lovely now show the children the twist", "twist"),
        ("my cousin is crazy about bts can you dance like them", "kpop"),
        ("ladies and gentlemen our robot will now perform a salsa", "salsa"),
        ("show to our audience the box step", "boxstep"),
        ("some disco would be great", "disco"),
        ("dance the volts", "waltz"),
        ("walk like a zomb e", "zombie"),
        ("do some two ting", "tutting"),
    ],
)
def test_run_on_and_misheard_requests_are_understood(text, skill, either):
    assert either.ground(text).skill == skill


@pytest.mark.parametrize(
    "text",
    [
        "do the test", "dance the samba", "do the tango", "let's paint the walls",
        "the monkey stole my banana", "thriller is my favourite song",
        "can you explain to us how the waltz works", "my brother can do the robot",
        "my grandma is ninety and she loves the waltz", "run the unit tests again",
    ],
)  # fmt: skip
def test_near_names_and_statements_start_nothing(text, either):
    assert either.ground(text).kind is IntentKind.CHAT


@pytest.mark.parametrize(
    "text",
    [
        "you can do the monkey later not now", "let's leave out the hula today",
        "please do not dance the salsa because the floor is wet",
        "my mum says you are not allowed to do the zombie", "do the twist no wait don't",
    ],
)  # fmt: skip
def test_run_on_refusals_start_nothing(text, either):
    assert either.ground(text).kind not in MOVES


def test_without_the_model_nothing_forbidden_is_done_and_phrases_work(by_letters, skills):
    rows = load_utterances(BUNDLED_UTTERANCES)
    result = score(by_letters, rows, "letters")
    assert result.negation_errors == 0, result.wrong
    assert result.false_triggers <= 0.03, result.wrong
    for name, skill in skills.items():
        for phrase in skill.phrases:
            intent = by_letters.ground(phrase)
            if name not in NOT_BY_VOICE and intent.kind is not IntentKind.STOP:
                assert intent.skill == name, phrase


def test_every_phrase_of_a_manifest_means_its_skill(either, skills):
    for name, skill in skills.items():
        if name in NOT_BY_VOICE:
            continue
        for phrase in skill.phrases:
            intent = either.ground(phrase)
            assert intent.kind is IntentKind.STOP or intent.skill == name, phrase


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_no_phrase_is_done_when_it_is_forbidden(data, either, skills):
    names = sorted(set(skills) - NOT_BY_VOICE)
    phrase = data.draw(st.sampled_from(skills[data.draw(st.sampled_from(names))].phrases))
    no = data.draw(st.sampled_from(["don't ", "do not ", "never ", "please don't do the ", "no "]))
    assert either.ground(no + phrase).kind not in MOVES


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_a_stop_beside_any_request_is_a_stop(data, either, skills):
    names = sorted(set(skills) - NOT_BY_VOICE)
    phrase = data.draw(st.sampled_from(skills[data.draw(st.sampled_from(names))].phrases))
    text = data.draw(st.sampled_from(["{}, stop", "stop. {}", "stop the {}", "{} and then stop"]))
    assert either.ground(text.format(phrase)).kind is IntentKind.STOP


@settings(max_examples=100, deadline=None)
@given(text=st.text(max_size=300))
def test_any_text_is_an_intent(text, either):
    intent = either.ground(text)
    assert 0.0 <= intent.score <= 1.0
    assert (intent.kind is IntentKind.SKILL) <= bool(intent.skill)


def test_numbers_travel_with_the_request(either):
    wave = either.ground("please wave your hand for five seconds")
    assert (wave.skill, wave.parameters.duration_s) == ("wave", 5.0)
    walk = either.ground("walk forward two metres")
    assert (walk.skill, walk.parameters.distance_m) == ("walk", 2.0)


def test_the_gesture_of_the_own_speech_is_not_for_asking(either):
    assert either.ground("make talking gestures").skill not in NOT_BY_VOICE


def test_standing_is_a_stop(either):
    assert either.ground("please stand").kind is IntentKind.STOP


def test_unknown_words_become_the_skill_they_sound_like():
    known = {"do", "the", "like", "bee", "a", "be", "dance", "her"}
    misheard = Misheard(["thriller", "zombie", "twist", "salsa"], known.__contains__)
    assert misheard.mend("do the thriler") == "do the thriller"
    assert misheard.mend("be a zom bee") == "be a zombie"
    assert misheard.mend("dance sal sa") == "dance salsa"
    assert misheard.mend("do the quokka") == "do the quokka"


def test_known_words_are_left_alone(model, skills):
    misheard = Misheard([text for one in skills.values() for text in one.phrases], model.knows)
    assert misheard.mend("do a handstand") == "do a handstand"
    for text in ("walk the talk", "the twins are here", "a robbery in the disco", "waves and wars"):
        assert misheard.mend(text) == text


def test_sentences_near_in_meaning_are_near_as_vectors(model):
    texts = ["wave at the audience", "greet the crowd with your hand", "my car needs new tyres"]
    first, near, far = model.embed(texts)
    assert np.allclose(np.linalg.norm([first, near, far], axis=1), 1.0, atol=1e-5)
    assert first @ near > 0.25 + first @ far


def test_a_vector_does_not_depend_on_its_neighbours_in_the_batch(model):
    alone = model.embed(["dance"])[0]
    beside = model.embed(["dance", "a much longer sentence that makes the others be padded"])[0]
    assert np.allclose(alone, beside, atol=1e-5)


def test_cosines_are_those_of_the_published_model(model):
    """The example of the published model's card."""
    a, b, c = model.embed(["That is a happy person", "That is a happy dog", "Today is a sunny day"])
    assert a @ b == pytest.approx(0.695, abs=0.01)
    assert a @ c == pytest.approx(0.257, abs=0.01)


def test_wrong_weights_are_refused(tmp_path):
    from downbeat.perception.sentence_model import SentenceModel, packaged_folder

    try:
        folder = packaged_folder()
    except PerceptionError as error:
        pytest.skip(str(error))
    for name in ("tokenizer.json", "config.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    weights = bytearray((folder / "model.safetensors").read_bytes())
    weights[-1] ^= 1
    (tmp_path / "model.safetensors").write_bytes(weights)
    with pytest.raises(PerceptionError, match="digest"):
        SentenceModel(tmp_path)
