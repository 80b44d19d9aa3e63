"""A page more than there is room for, in a real browser: it says so, and opens by itself when there is."""

from __future__ import annotations

from hardening.server import served

from view_app_page import SMALL, Watched, saw

pytest_plugins = ("view_app_fixtures",)


def test_a_page_too_many_says_so_and_opens_when_another_closes(browser) -> None:
    with served("--sessions", "1", "--host", "0.0.0.0") as app:
        other = app.session()
        watched = Watched(browser.new_context(viewport=SMALL))
        page = watched.page
        page.goto(app.address)
        saw(page, "A token is needed")
        page.get_by_label("token").fill(str(app.token))
        page.get_by_role("button", name="Open").click()
        saw(page, "Too many pages")
        saw(page, "1 pages are open, which is the limit")
        assert "token" not in page.url  # the cookie has it, not the history
        other.close()
        page.locator("#root").wait_for(state="attached")  # the app's own page
        assert watched.strangers() == []
        page.context.close()
