"""The script: eighteen sentences, six of each emotion, and how they sound."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Sentence:
    """A line of the script.

    Parameters
    ----------
    name : str
        `pride_1` to `contempt_6`.
    text : str
    phones : tuple of str
        ARPAbet; a vowel ends in 1 where it is stressed; `|` is a short pause.
    """

    name: str
    text: str
    phones: tuple

    @property
    def emotion(self):
        """One of `data_synth.performance.emotion.EMOTIONS`."""
        return self.name.split("_")[0]

    @property
    def split(self):
        """`train` for the first four of each emotion, `test` for the last two."""
        return "train" if int(self.name.split("_")[1]) <= 4 else "test"


_SCRIPT = {
    "pride_1": ("We built this bridge with our own hands.",
                "W IY B IH1 L T DH IH S B R IH1 JH W IH DH AW ER OW1 N HH AE1 N D Z"),
    "pride_2": ("My daughter was the first one over the line.",
                "M AY D AO1 T ER W AH Z DH AH F ER1 S T W AH N OW1 V ER DH AH L AY1 N"),
    "pride_3": ("Nobody thought it could fly, | and look at it now.",
                "N OW1 B AA D IY TH AO1 T IH T K UH D F L AY1 | AE N D L UH1 K AE T IH T N AW1"),
    "pride_4": ("Forty years, and I never missed a show.",
                "F AO1 R T IY Y IH1 R Z | AE N D AY N EH1 V ER M IH1 S T AH SH OW1"),
    "pride_5": ("You may put my name above the door.",
                "Y UW M EY P UH1 T M AY N EY1 M AH B AH1 V DH AH D AO1 R"),
    "pride_6": ("They said it was hopeless, and we finished early.",
                "DH EY S EH1 D IH T W AH Z HH OW1 P L AH S | AE N D W IY F IH1 N IH SH T ER1 L IY"),
    "rage_1": ("Who gave you the right to open that letter?",
               "HH UW1 G EY1 V Y UW DH AH R AY1 T T UW OW1 P AH N DH AE T L EH1 T ER"),
    "rage_2": ("Get your boots off my father's grave!",
               "G EH1 T Y AO R B UW1 T S AO1 F M AY F AA1 DH ER Z G R EY1 V"),
    "rage_3": ("You sold the farm, and you shook my hand.",
               "Y UW S OW1 L D DH AH F AA1 R M | AE N D Y UW SH UH1 K M AY HH AE1 N D"),
    "rage_4": ("I have been waiting in the rain for three hours!",
               "AY HH AE V B IH N W EY1 T IH NG IH N DH AH R EY1 N F AO R TH R IY1 AW1 ER Z"),
    "rage_5": ("Break one more promise and we are finished!",
               "B R EY1 K W AH1 N M AO1 R P R AA1 M IH S AE N D W IY AA R F IH1 N IH SH T"),
    "rage_6": ("Shut up, just shut up and move your car!",
               "SH AH1 T AH1 P | JH AH S T SH AH1 T AH1 P AE N D M UW1 V Y AO R K AA1 R"),
    "contempt_1": ("How charming, he owns a second shirt.",
                   "HH AW1 CH AA1 R M IH NG | HH IY OW1 N Z AH S EH1 K AH N D SH ER1 T"),
    "contempt_2": ("I would not trust him to boil water.",
                   "AY W UH D N AA1 T T R AH1 S T HH IH M T UW B OY1 L W AO1 T ER"),
    "contempt_3": ("Of course you forgot, you always do.",
                   "AH V K AO1 R S Y UW F ER G AA1 T | Y UW AO1 L W EY Z D UW1"),
    "contempt_4": ("Was that a speech, or were you clearing your throat?",
                   "W AH Z DH AE1 T AH S P IY1 CH | AO R W ER Y UW K L IH1 R IH NG Y AO R "
                   "TH R OW1 T"),
    "contempt_5": ("Please, show us your famous method again.",
                   "P L IY1 Z | SH OW1 AH S Y AO R F EY1 M AH S M EH1 TH AH D AH G EH1 N"),
    "contempt_6": ("A child could paint it, and a child did.",
                   "AH CH AY1 L D K UH D P EY1 N T IH T | AE N D AH CH AY1 L D D IH1 D"),
}  # fmt: skip

SENTENCES = {
    name: Sentence(name, text.replace("| ", ""), tuple(phones.split()))
    for name, (text, phones) in _SCRIPT.items()
}
"""The eighteen sentences by name: six of each emotion, four to train on and two to test."""
