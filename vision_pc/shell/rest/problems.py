"""The problem documents of this service: the HTTP status of the causes that its requests end with."""

from http import HTTPStatus
from typing import Any

from foundation.rest import problems

STATUS_OF_CAUSE = {
    "refused.unknown_operation": HTTPStatus.NOT_FOUND,
    "refused.unknown_program": HTTPStatus.NOT_FOUND,
    "refused.too_many_followers": HTTPStatus.SERVICE_UNAVAILABLE,
    "refused.key_reused": HTTPStatus.UNPROCESSABLE_ENTITY,
    "refused.key_spent": HTTPStatus.GONE,
    "request.repeated_header": HTTPStatus.BAD_REQUEST,
    "request.bad_header": HTTPStatus.BAD_REQUEST,
    "refused.unknown_target": HTTPStatus.NOT_FOUND,
    "refused.no_look_yet": HTTPStatus.NOT_FOUND,
    "refused.bad_target": HTTPStatus.UNPROCESSABLE_ENTITY,
    "refused.bad_setting": HTTPStatus.UNPROCESSABLE_ENTITY,
}


def problem_of(error: Exception) -> dict[str, Any]:
    """The problem document of an exception that ended an operation."""
    return problems.problem_of(error, STATUS_OF_CAUSE)
