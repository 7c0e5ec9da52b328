"""`GET /metrics`: what the vision PC counts of itself, of its link and of the controller, for Prometheus."""

from fastapi import FastAPI, Response

from foundation.rest.metrics import MEDIA_TYPE, exposition
from vision_pc.application.application import VisionApplication
from vision_pc.shell.rest.link_view import link_view
from vision_pc.shell.rest.state_view import arm_json

_OF_THE_CONTROLLER = (
    "cycle", "plant_link_ok", "emergency_latched", "settled", "references_lost", "references_dropped",
    "supply_bar",
)  # fmt: skip


def add_metrics(app: FastAPI, application: VisionApplication) -> None:
    """Add the address; it is none of the API's that clients rely on, and not in its document."""

    @app.get("/metrics", include_in_schema=False)
    async def metrics() -> Response:
        """Always answered: without a controller its own figures are left out."""
        controller = application.controller
        figures = dict(application.figures())
        figures["reference_link"] = link_view(controller).model_dump(exclude={"controller"})
        if controller.connected:
            told = arm_json(controller.state)
            figures["controller"] = {name: told[name] for name in _OF_THE_CONTROLLER}
        return Response(exposition("vision_pc", figures), media_type=MEDIA_TYPE)
