"""Types of bodies and answers, one for each schema of the OpenAPI document."""

from ._generated.types import *  # noqa: F403
