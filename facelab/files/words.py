"""How readers and writers say it: a few names of many, each name once, and what is damaged."""

from collections import Counter


def listed(names, most=6):
    """Names as one reads them in a sentence, the first few of many.

    Examples
    --------
    >>> listed(["chin", "nose", "brow", "lip"], most=2)
    'chin, nose and 2 more'
    """
    names = list(names)
    rest = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(map(str, names[:most])) + rest


def quoted(names, most=6):
    """As `listed`, each name in quotes.

    Examples
    --------
    >>> quoted(["chin", "nose"])
    "'chin', 'nose'"
    """
    return listed(map(repr, names), most)


def distinct(names, form="{} ({})"):
    """The names, each once: those that stand again are numbered, past names that are there.

    Examples
    --------
    >>> distinct(["eye", "eye", "eye (2)"])
    ['eye', 'eye (3)', 'eye (2)']
    """
    taken, seen, found = set(names), Counter(), []
    for name in names:
        seen[name] += 1
        new = name
        if seen[name] > 1:
            while (new := form.format(name, seen[name])) in taken:
                seen[name] += 1
            taken.add(new)
        found.append(new)
    return found


def damaged(text):
    """The error for a file that contradicts itself, of its name, the place and what is there."""
    return ValueError(f"{text}; the file is damaged, export it again.")
