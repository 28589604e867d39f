"""Sentences for the engines, covering every phone and every class of diphone.

English sentences come from templates and word lists weighted towards visible sounds (p b m, f v,
rounded vowels), and from random words, which give phone pairs that are rare in grammatical text.
Other languages have a short list each, for their phones.
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

NOUNS = (
    "apple bubble cabin map farm film pumpkin oven movie family problem home moment beach boat "
    "bowl judge village garage treasure thing tooth mouth path leather feather brother mother "
    "weather shoe chair choice voice boy toy noise house cow cloud town moon spoon school book "
    "foot cook wolf bird girl nurse word fire hour flower zebra zoo garden kitchen finger king "
    "ring yard year onion window water queen lamp pepper picture puppet baby member number summer "
    "winter camera computer animal memory vehicle marble bamboo album vapour paper fever favour"
).split()
ADJECTIVES = (
    "big small blue brown warm cold happy quick smooth rough perfect beautiful famous valuable "
    "awful yellow purple empty heavy loud quiet good new old young thick thin bitter better "
    "important possible private public human broken fuzzy fresh wooden golden lovely simple tiny "
    "marvellous feeble brave vivid humble"
).split()
VERBS = (
    "made found bought gave moved opened pushed pulled loved believed saw watched painted shaped "
    "brought remembered forgot took kept left wanted needed used broke measured cooked washed "
    "fixed carried chose covered sang played changed proved dropped stopped helped grabbed "
    "improved approved forgave"
).split()
SUBJECTS = (
    "Bob|Mary|Papa|Mama|Phoebe|Victor|Zoe|Joy|my brother|her mother|this boy|those people|"
    "the village|a farmer|we|they|you|I|George|Sue|Tom|Kate|nobody|everyone"
).split("|")
PLACES = (
    "maybe|perhaps|by the beach|above the farm|before the movie|for a moment|over the bridge|"
    "with both of them|in the morning|about five times|from the garage|behind the oven|"
    "under the map|without a problem|through the path|at home|in spite of everything"
).split("|")
EXCLAMATIONS = "wow oh yes no please stop never hey what really come on watch out".split()
HELD = "no so oh please wow hey more far you me why way blue moon home now my there".split()
NUMBERS = "zero one two three four five six seven eight nine ten eleven fifteen forty".split()
TENS = (0, 7, 12, 45, 58, 96, 100, 365, 1984, 7500)

FOREIGN = {
    "es": (
        "Mi familia vive cerca de una plaza muy bonita.",
        "¿Puedes abrir la ventana, por favor? Hace mucho calor.",
        "El niño pequeño bebe un vaso de leche fría.",
        "¡Qué maravilla! Nunca había visto tantas flores.",
        "Mañana compramos pan, fruta y un pollo grande.",
        "Yo trabajo hoy, pero el jueves voy al mar.",
    ),
    "de": (
        "Meine Mutter backt jeden Freitag frisches Brot.",
        "Könnten wir bitte früher über die Brücke gehen?",
        "Das Pferd trinkt Wasser aus einem blauen Eimer.",
        "Heute habe ich zwölf schöne Äpfel gepflückt!",
        "Der Zug fährt pünktlich um halb fünf ab.",
        "Vielleicht bleibt der Himmel morgen ganz wolkenlos.",
    ),
    "fr": (
        "Mon petit frère boit un bon verre de lait.",
        "Est-ce que vous voulez du pain avec un peu de beurre ?",
        "La lune brille au-dessus de la vieille maison blanche.",
        "Quelle belle surprise ! Je suis tellement heureux.",
        "Il fait froid, mais les oiseaux chantent au jardin.",
        "Nous avons vu huit bateaux près du pont.",
    ),
    "it": (
        "La mamma prepara una buona zuppa di piselli.",
        "Vuoi venire al mare con la mia famiglia?",
        "Ogni giorno bevo un bicchiere di acqua fresca.",
        "Che bella giornata! Il cielo è proprio azzurro.",
        "Abbiamo perso le chiavi sotto il ponte vecchio.",
        "Gli amici di Paolo giocano fuori fino a sera.",
    ),
    "pt": (
        "Minha irmã comprou pão e um bolo de maçã.",
        "Você pode fechar a porta, por favor?",
        "O vento bate forte na janela do meu quarto.",
        "Que maravilha! Nunca vi um peixe tão bonito.",
        "Amanhã vamos de barco até a ilha verde.",
        "Os filhos do vizinho brincam muito bem juntos.",
    ),
    "cmn": (  # pinyin with tones as digits: espeak-ng reads tone marks as English
        "Wo3 de5 ma1ma5 mei3 tian1 zao3shang5 mai3 mian4bao1.",
        "Ni3 ming2bai5 bu4 ming2bai5 zhe4ge5 wen4ti2?",
        "Ba4ba5 he2 peng2you5 yi4qi3 qu4 bei3bian1 pa2shan1.",
        "Jin1tian1 de5 feng1 fei1chang2 da4, wo3men5 bu4 chu1men2.",
        "Tai4 piao4liang5 le5! Wo3 xi3huan5 zhe4 pian4 lv4se4 de5 hu2.",
        "Ta1 pao3bu4 pao3 de5 hen3 kuai4, bu2 pa4 xia4 yu3.",
    ),
    "hi": (
        "मेरी माँ बाज़ार से फल लाती है।",
        "क्या आप मुझे पानी दे सकते हैं?",
        "बच्चे बगीचे में बहुत देर तक खेलते हैं।",
        "वाह! यह फूल कितना सुंदर है।",
        "मैं भाई के साथ पुल पर चलता हूँ।",
        "आज मौसम बहुत अच्छा है, बाहर चलो।",
    ),
    "ja": (
        "ははは まいあさ パンを たべます。",
        "この みちは えきまで どのくらい ですか。",
        "ふたりの こどもが にわで あそんで います。",
        "すごい。うみが とても きれいですね。",
        "ぼくは バスで びょういんに いきます。",
        "むかし、ふるい もりに おばあさんが すんで いました。",
    ),
    "ko": (
        "어머니는 아침마다 빵을 만드십니다.",
        "이 버스는 바다까지 갑니까?",
        "아이들이 마당에서 재미있게 놀아요.",
        "와, 정말 예쁜 꽃이에요!",
        "나무 위에서 까마귀가 울고 있어요.",
        "우리는 매일 밤 책을 읽습니다.",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Sentence:
    """A sentence to synthesise.

    Attributes
    ----------
    text : str
        Plain text with punctuation.
    held : str
        A word to lengthen ("nooo"); empty if none.
    """

    text: str
    held: str = ""


@cache
def words() -> tuple[str, ...]:
    """The project's own list of common English words."""
    listed = files("deitalk.research.corpus").joinpath("words.txt").read_text(encoding="utf-8")
    return tuple(listed.split())


def english_sentence(rng: np.random.Generator) -> Sentence:
    """A random sentence: statement, question, exclamation, list, number or loose words.

    Parameters
    ----------
    rng : Generator
        Source of all choices.

    Returns
    -------
    sentence : Sentence
    """
    makers = (_loose_words, _statement, _list, _exclamation, _question, _numbers, _lingering)
    chance = (0.30, 0.28, 0.14, 0.09, 0.08, 0.06, 0.05)
    sentence = makers[rng.choice(len(makers), p=chance)](rng)
    return Sentence(sentence.text[0].upper() + sentence.text[1:], sentence.held)


def foreign_sentence(language: str, rng: np.random.Generator) -> Sentence:
    """A random sentence of one of the languages of `FOREIGN`."""
    return Sentence(_one(rng, FOREIGN[language]))


def _one(rng: np.random.Generator, choices: tuple[str, ...] | list[str]) -> str:
    return choices[rng.integers(len(choices))]


def _ending(rng: np.random.Generator) -> str:
    return _one(rng, (".", ".", ".", "!", "?"))


def _loose_words(rng: np.random.Generator) -> Sentence:
    """Three to seven unrelated words, sometimes with a pause."""
    chosen = [_one(rng, words()) for _ in range(rng.integers(3, 8))]
    if rng.random() < 0.25:
        chosen[rng.integers(len(chosen) - 1)] += _one(rng, (",", "...", "."))
    return Sentence(" ".join(chosen) + _ending(rng))


def _clause(rng: np.random.Generator) -> str:
    thing = f"the {_one(rng, ADJECTIVES)} {_one(rng, NOUNS)}"
    return f"{_one(rng, SUBJECTS)} {_one(rng, VERBS)} {thing}"


def _statement(rng: np.random.Generator) -> Sentence:
    return Sentence(f"{_clause(rng)} {_one(rng, PLACES)}{_ending(rng)}")


def _list(rng: np.random.Generator) -> Sentence:
    owner = _one(rng, ["my", "our", "every", "some", "both"])
    things = f"{owner} {_one(rng, NOUNS)}, a {_one(rng, NOUNS)} and the {_one(rng, NOUNS)}"
    begin = f"{_one(rng, PLACES)}, {_one(rng, SUBJECTS)} {_one(rng, VERBS)}"
    return Sentence(f"{begin} {things}{_ending(rng)}")


def _exclamation(rng: np.random.Generator) -> Sentence:
    return Sentence(f"{_one(rng, EXCLAMATIONS)}! {_clause(rng)}{_one(rng, ('!', '.'))}")


def _question(rng: np.random.Generator) -> Sentence:
    begin = _one(
        rng, ["do you believe", "who said", "why did you say", "how do you know", "is it true"]
    )
    return Sentence(f"{begin} that {_clause(rng)}?")


def _numbers(rng: np.random.Generator) -> Sentence:
    if rng.random() < 0.5:
        digits = [_one(rng, NUMBERS) for _ in range(rng.integers(3, 7))]
        return Sentence(", ".join(digits) + ".")
    count = TENS[rng.integers(len(TENS))] + int(rng.integers(5))
    return Sentence(f"{_one(rng, SUBJECTS)} {_one(rng, VERBS)} {count} {_one(rng, NOUNS)}s.")


def _lingering(rng: np.random.Generator) -> Sentence:
    held = _one(rng, HELD)
    begin = _one(rng, ["oh", "well", "but", "please", "mmm"])
    return Sentence(f"{begin}, {held}, {_one(rng, VERBS)} by {_one(rng, SUBJECTS)}!", held)
