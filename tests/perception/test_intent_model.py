"""What was learned of how people ask: the model, and its place among the rules."""

from dataclasses import replace

import numpy as np
import pytest

from downbeat.perception.errors import PerceptionError
from downbeat.perception.grounding import Grounder, IntentKind
from downbeat.perception.grounding_learned import Learned
from downbeat.perception.grounding_rules import Clause, Form, clauses
from downbeat.perception.intent_model import FORMS, WEIGHTS, IntentModel, written
from downbeat.perception.sentence_model import SentenceModel, adapted
from downbeat.policies.manifest import load_skills
from downbeat.runtime.errors import DownbeatError
from downbeat.tools.eval_speech import BUNDLED_UTTERANCES, load_utterances
from downbeat.tools.speech_parts import hub_folder, make_grounder
from downbeat.tools.train_intents import load_sentences


@pytest.fixture(scope="module")
def intents():
    try:
        return IntentModel()
    except PerceptionError as error:
        pytest.skip(str(error))


class Says:
    """A model that always wants the same."""

    classes = ("chat", "not", "stop", "faster", "waltz", "twist")

    def __init__(self, wanted, probability):
        self._row = np.full(len(self.classes), (1.0 - probability) / (len(self.classes) - 1))
        self._row[self.classes.index(wanted)] = probability

    def judge(self, texts):
        return np.tile(self._row.astype(np.float32), (len(texts), 1))


def learned(wanted, probability=0.99, skills=("waltz", "twist")):
    return Learned(Says(wanted, probability), skills, lambda clause: clause.text)


def wants(judge, text):
    from downbeat.perception.grounding_numbers import Parameters

    return judge.intent(text, clauses(text), Parameters())


def test_every_class_is_a_bundled_skill_or_a_form(intents):
    assert set(intents.classes) - FORMS <= set(load_skills())


def test_probabilities_do_not_depend_on_marks_capitals_or_neighbours(intents):
    alone = intents.judge(["do the waltz, please"])[0]
    beside = intents.judge(["Do the Waltz, please!", "something else that is a good deal longer"])
    assert alone.sum() == pytest.approx(1.0, abs=1e-5)
    assert np.allclose(alone, beside[0], atol=1e-4)


def test_a_described_dance_is_asked_for_and_talk_about_it_is_not(intents):
    grounder = Grounder(load_skills(), intents, intents=intents)
    asked = grounder.ground("shuffle about as if you had just crawled out of a grave")
    assert (asked.kind, asked.skill) == (IntentKind.SKILL, "zombie")
    told = grounder.ground("my uncle taught the waltz to half of the village")
    assert told.kind is IntentKind.CHAT


@pytest.mark.parametrize("text", ["don't dance the waltz", "never ever do the waltz again"])
def test_what_is_only_forbidden_is_not_begun_whatever_the_model_says(text):
    assert wants(learned("waltz", 1.0), text).kind is IntentKind.CHAT


def test_a_question_has_to_be_surer_than_a_request():
    judge = learned("waltz", 0.5)
    assert wants(judge, "can you do something like that").skill == "waltz"
    assert wants(judge, "who was johann strauss").kind is IntentKind.CHAT


def test_what_is_not_in_the_catalogue_is_talk():
    assert wants(learned("waltz", skills=("twist",)), "waltz please").kind is IntentKind.CHAT


def test_faster_is_a_tempo_with_its_direction():
    found = wants(learned("faster"), "give it some gas")
    assert (found.kind, found.parameters.tempo) == (IntentKind.TEMPO, 1)


def test_the_mended_text_is_judged_where_the_words_say_nothing():
    class Hears(Says):
        def judge(self, texts):
            return Says("waltz" if "waltz" in texts[0] else "chat", 0.99).judge(texts)

    judge = Learned(Hears("chat", 1.0), ("waltz",), lambda clause: "dance the waltz")
    assert Clause(Form.REQUEST, "dance the walls") in clauses("dance the walls")
    assert wants(judge, "dance the walls").skill == "waltz"


def test_a_skill_that_was_not_learned_is_found_by_its_phrases(intents):
    skills = load_skills()
    own = replace(
        skills["waltz"], name="pirouette", title="Pirouette", phrases=("pirouette",),
        descriptions=("spin around on one toe like a ballerina",),
    )  # fmt: skip
    grounder = Grounder({**skills, "pirouette": own}, SentenceModel(), intents=intents)
    assert grounder.ground("please spin around on one toe").skill == "pirouette"
    assert grounder.ground("may we see a waltz").skill == "waltz"
    assert grounder.ground("what is the capital of portugal").kind is IntentKind.CHAT


def test_the_test_half_was_not_learned():
    learned_texts = {one.text for one in load_sentences()}
    test = {written(one.text) for one in load_utterances(BUNDLED_UTTERANCES) if one.half == "test"}
    assert len(test) >= 100
    assert not test & learned_texts


def test_weights_that_are_none_or_of_another_transformer_are_refused(tmp_path):
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"PK nothing")
    with pytest.raises(DownbeatError, match="holds no intents"):
        IntentModel(weights=broken)
    with np.load(WEIGHTS) as file:
        arrays = dict(file)
    other = tmp_path / "other.npz"
    np.savez(other, **{**arrays, "base": np.array("0" * 64)})
    with pytest.raises(DownbeatError, match="trained on the sentence model"):
        IntentModel(weights=other)


def test_an_update_is_added_to_its_matrix_and_to_no_other():
    rng = np.random.default_rng(0)
    weights = {name: rng.standard_normal((4, 3)).astype(np.float32) for name in ("a", "b")}
    up, down = rng.standard_normal((4, 2)), rng.standard_normal((2, 3))
    result = adapted(weights, {"a.up": up, "a.down": down})
    assert np.allclose(result["a"], weights["a"] + up @ down, atol=1e-5)
    assert result["b"] is weights["b"]


def test_a_sentence_model_that_cannot_be_had_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    with pytest.raises(PerceptionError, match=r"speech\.toml: sentence_model"):
        hub_folder("nobody/no-such-model")
    assert hub_folder(str(tmp_path)) == tmp_path


def test_another_sentence_model_by_configuration_understands_by_likeness():
    from downbeat.perception.sentence_model import packaged_folder
    from downbeat.perception.speech_config import SpeechConfig

    try:
        folder = packaged_folder()
    except PerceptionError as error:
        pytest.skip(str(error))
    config = SpeechConfig(sentence_model=str(folder))
    assert make_grounder(config, load_skills()).ground("show us a salsa").skill == "salsa"


@pytest.mark.slow
def test_training_and_running_are_the_same_function(tmp_path):
    torch = pytest.importorskip("torch")
    from downbeat.tools.train_intents import Trainee

    trainee = Trainee(("chat", "waltz", "stop"), rank=2)
    with torch.no_grad():
        for name, value in trainee.updates.items():
            if name.endswith(".up"):
                value.normal_(0.0, 0.02)
    trainee.save(tmp_path / "intents.npz")
    texts = ["do the waltz", "my uncle taught the waltz to half of the village, they say"]
    here = IntentModel(weights=tmp_path / "intents.npz").judge(texts)
    assert np.allclose(here, trainee.probabilities(texts), atol=5e-3)
