"""Systems whose parts answer as one, for the tests: attributes are those of the navigator, then of the front end."""

from typing import Any

from ins_nav.navigator.system import FilterSystem, NavigationSystem


class Ins(NavigationSystem):
    """An `ins_node` without other nodes."""

    def __init__(self, overrides: Any = None, aided: bool = False) -> None:
        super().__init__(overrides, aided)

    def __getattr__(self, name: str) -> Any:
        if name in ("realtime", "front_end"):  # not there yet
            raise AttributeError(name)
        part = self.realtime if hasattr(self.realtime, name) else self.front_end
        return getattr(part, name)


class Filter(FilterSystem):
    """An `alignment_node`."""

    def __getattr__(self, name: str) -> Any:
        if name in ("delayed", "front_end"):
            raise AttributeError(name)
        part = self.delayed if hasattr(self.delayed, name) else self.front_end
        return getattr(part, name)
