"""What goes wrong in a callback, shown in the page: the widget machinery would swallow it."""

import functools
import html
import traceback


def shows_errors(method):
    """Pass what a callback raises on to the `_fail` of its view.

    Its `step_made` tells whether the state of the view's session, if it has one, is another now.
    """

    @functools.wraps(method)
    def guarded(self, *args, **kwargs):
        session = getattr(self, "session", None)
        before = getattr(session, "state", None)
        try:
            return method(self, *args, **kwargs)
        except Exception as error:
            error.step_made = getattr(session, "state", None) is not before
            self._fail(error)

    return guarded


def error_box(error, what_now):
    """An error as HTML: what happened, where, and in words what is shown now."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return (
        '<div style="border-left:4px solid #b00020;padding:4px 8px;background:#fdecee;'
        f'color:#5f0011;line-height:1.35"><b>That did not work.</b> {html.escape(what_now)}<br>'
        f"{html.escape(f'{type(error).__name__}: {error}')}<br>"
        f"<small>{html.escape(last.name)}, line {last.lineno}</small></div>"
    )
