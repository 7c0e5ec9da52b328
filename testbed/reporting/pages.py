"""The pages that runs leave: of one style, each one file that needs no other and no network."""

import time
from typing import Any


def rendered(template: str, **values: Any) -> str:
    """The page that ``template`` makes of ``values``, to which the time of writing is added."""
    from jinja2 import Environment, PackageLoader  # here: a command that only lists runs need not wait for it

    environment = Environment(loader=PackageLoader("testbed.reporting"), autoescape=True)
    return environment.get_template(template).render(written=time.strftime("%Y-%m-%d %H:%M:%S"), **values)
