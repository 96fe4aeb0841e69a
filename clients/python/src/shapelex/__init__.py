"""Client of Shapelex, a service for statistics of shapes: NumPy arrays in, arrays, frames and figures out.

`Client` is blocking, `AsyncClient` is the same for asyncio; `Server.start()` runs a service for notebooks and tests.
"""

from ._aio import AsyncClient, AsyncCohort, AsyncDictionary, AsyncJob
from ._reply import Event, Reply
from ._shapes import Shapes
from ._sync import Client, Cohort, Dictionary, Job
from .errors import (
    AccessDenied,
    Busy,
    Conflict,
    Fault,
    InvalidInput,
    JobCancelled,
    JobFailed,
    MissingPackage,
    NotFound,
    Problem,
    ShapelexError,
    Unreachable,
)
from .results import Added, Comparison, LinearModel, Mean, Modes, Morphospace, Outlines
from .server import NoServer, Server

__version__ = "0.1.0"

__all__ = [
    "AccessDenied",
    "Added",
    "AsyncClient",
    "AsyncCohort",
    "AsyncDictionary",
    "AsyncJob",
    "Busy",
    "Client",
    "Cohort",
    "Comparison",
    "Conflict",
    "Dictionary",
    "Event",
    "Fault",
    "InvalidInput",
    "Job",
    "JobCancelled",
    "JobFailed",
    "LinearModel",
    "Mean",
    "MissingPackage",
    "Modes",
    "Morphospace",
    "NoServer",
    "NotFound",
    "Outlines",
    "Problem",
    "Reply",
    "Server",
    "Shapes",
    "ShapelexError",
    "Unreachable",
]
