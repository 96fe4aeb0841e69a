"""Asynchronous client: cohorts, dictionaries and jobs over the calls of the OpenAPI document."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, cast

import httpx
import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Self

from ._generated.async_calls import AsyncCalls
from ._helpers import (
    CLOSED_KINDS,
    Progress,
    column_of,
    filtered,
    grid_of,
    is_path,
    method_of,
    outlines_of,
    representation_of,
    scores_of,
    uploaded,
)
from ._reply import NPY, Reply, expect, imported
from ._shapes import Shapes, as_shapes
from .errors import JobCancelled, JobFailed, problem
from .results import Added, Comparison, LinearModel, Mean, Modes, Morphospace, Outlines, control_points

if TYPE_CHECKING:
    import pandas as pd

    from ._generated import types as t
    from ._shapes import Columns, Texts

# Bytes of coordinates in one upload; more are sent in parts.
PART = 256 << 20
# Seconds between two looks at a job, at first and at most.
FIRST_LOOK, LAST_LOOK = 0.05, 2.0
# Seconds that a request waits for its job, before the client looks itself and shows progress.
WAIT = "wait=2"


class AsyncClient:
    """Asynchronous client of a service.

    Parameters
    ----------
    url : str, optional
        Address of the service. Default: `SHAPELEX_SERVER`, else `http://127.0.0.1:8080`.
    key : str, optional
        Key or token. Default: `SHAPELEX_KEY`, else none.
    tries : int
        Times that a request is sent at most.
    timeout : float
        Seconds without a byte of an answer.
    http : httpx.AsyncClient, optional
        Client to send with; it is not closed.

    Attributes
    ----------
    calls : AsyncCalls
        A typed call for every operation of the OpenAPI document.
    """

    def __init__(
        self,
        url: str | None = None,
        key: str | None = None,
        *,
        tries: int = 6,
        timeout: float = 300.0,
        http: httpx.AsyncClient | None = None,
    ) -> None:
        self.calls = AsyncCalls(url, key, tries=tries, timeout=timeout, http=http)

    @property
    def url(self) -> str:
        """Address of the service."""
        return self.calls.url

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.url}>"

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.aclose()

    async def aclose(self) -> None:
        """Closes the connections."""
        await self.calls.aclose()

    async def version(self) -> str:
        """Version of the service."""
        return (await self.calls.find_version()).json()["version"]

    async def pages(self, call: Callable[..., Awaitable[Reply[Any]]], *given: Any, **named: Any) -> AsyncIterator[Any]:
        """All entries of a list, page after page.

        Parameters
        ----------
        call : callable
            A call that answers pages, such as `client.calls.list_jobs`.
        *given, **named
            Its parameters.
        """
        cursor = named.pop("cursor", None)
        while True:
            page = (await call(*given, **named, cursor=cursor)).json()
            for entry in page["items"]:
                yield entry
            cursor = page.get("next")
            if cursor is None:
                return

    def cohort(self, name: str) -> AsyncCohort:
        """The cohort of this name or id; no request is made."""
        return AsyncCohort(self, name)

    async def cohorts(self) -> AsyncIterator[AsyncCohort]:
        """All cohorts."""
        async for entry in self.pages(self.calls.list_cohorts, limit=1000):
            yield AsyncCohort(self, entry["name"])

    async def create_cohort(
        self,
        name: str,
        shapes: Any = None,
        *,
        representation: Mapping[str, Any] | None = None,
        kind: str = "closed_curve",
        control_points: int | None = None,
        dimension: int | None = None,
        generator: str | Mapping[str, Any] = "trigonometric",
        correspondence: str | None = None,
        length_unit: str | None = None,
        exist_ok: bool = False,
        on_error: str = "abort",
        **further: Any,
    ) -> AsyncCohort:
        """Creates a cohort, and stores shapes in it.

        Parameters
        ----------
        name : str
            Unique name.
        shapes : optional
            Shapes to store, as `AsyncCohort.add` takes them.
        representation : mapping, optional
            The representation as the service takes it, in place of the next four.
        kind : {"closed_curve", "open_curve", "landmarks"}
            Kind of the shapes.
        control_points : int, optional
            Number of control points, of intervals of open curves, or of landmarks. Default: 32, or as many landmarks as
            the shapes have.
        dimension : int, optional
            Coordinates of a point. Default: those of the shapes, else 2.
        generator : str or mapping
            Generator of the curves, by its name or with its parameters.
        correspondence : {"landmarks", "arc_length", "cyclic"}, optional
            How points of two shapes correspond. Default: `cyclic` for closed curves, `arc_length` for open ones.
        length_unit : str, optional
            Unit of the coordinates, such as `mm` or `pixel`.
        exist_ok : bool
            Whether a cohort of this name is taken as it is.
        on_error : {"abort", "skip"}
            What a bad shape does: it refuses all of them, or is left out.
        **further
            Further fields of the request: `direction`, `mirror`, `description`.
        """
        given = None if shapes is None or is_path(shapes) else as_shapes(shapes)
        chosen = dict(representation or representation_of(kind, control_points, dimension, generator, given))
        rules = {"closed_curve": "cyclic", "open_curve": "arc_length"}
        body = {
            "name": name,
            "representation": chosen,
            "correspondence": correspondence or rules.get(str(chosen["kind"])),
            "length_unit": length_unit,
            **further,
        }
        cohort = AsyncCohort(self, name)
        if not (exist_ok and await cohort.exists()):
            await self.calls.create_cohort(cast("t.CohortRequest", body))
        if shapes is not None:
            await cohort.add(shapes if given is None else given, on_error=on_error)
        return cohort

    def dictionary(self, name: str) -> AsyncDictionary:
        """The dictionary of this id, `name@version`, `name@alias` or name; no request is made."""
        return AsyncDictionary(self, name)

    async def dictionaries(self, **chosen: Any) -> AsyncIterator[AsyncDictionary]:
        """All versions of all dictionaries, or those of a `name` or `cohort`."""
        async for entry in self.pages(self.calls.list_dictionaries, limit=1000, **chosen):
            yield AsyncDictionary(self, entry["id"])

    async def job(self, id: str) -> AsyncJob:
        """The job of this id."""
        return AsyncJob(self, (await self.calls.find_job(id)).json())

    async def jobs(self, **chosen: Any) -> AsyncIterator[AsyncJob]:
        """Jobs, newest first, or those of a `status`, `kind` or `cohort`."""
        async for entry in self.pages(self.calls.list_jobs, **chosen):
            yield AsyncJob(self, entry)

    async def read(self, path: str | os.PathLike[str], **options: Any) -> Shapes:
        """Reads the shapes of a file of any format of the service, without storing them.

        Parameters
        ----------
        path : path
            The file.
        **options
            Options of reading, such as `closed=True`, `holes="keep"` or `format="tps"`.

        Returns
        -------
        Shapes
            Points as arrays, with ids, labels and attributes.
        """
        file, options = Path(path), {name: column_of(value) for name, value in options.items()}
        expect(file.is_file(), f"expected a file at {file}, got none")
        options.setdefault("name", file.name)
        reply = await self.calls.convert_file(file, to="npz", **options)
        return Shapes.of_arrays(reply.arrays())

    async def evaluate(
        self, representation: Mapping[str, Any], shapes: ArrayLike, *, samples: int = 200, grid: int = 48
    ) -> Outlines:
        """Points on shapes that are given by control points.

        Parameters
        ----------
        representation : mapping
            As the service answers it.
        shapes : array_like of shape (n, N, d)
            Control points.
        samples : int
            Points on a curve, at equal steps of the parameter.
        grid : int
            Points on a surface along each direction.

        Returns
        -------
        Outlines
            Points of shape (n, samples, d), or (n, grid, grid, 3) on spline surfaces.
        """
        rows = np.asarray(shapes, dtype=np.float64)
        if representation["kind"] == "landmarks":
            return Outlines(rows, "landmarks")
        body: dict[str, Any] = {
            "representation": dict(representation),
            "shapes": [{"control_points": shape} for shape in rows],
        }
        body |= {"closed_curve": {"samples": samples}, "open_curve": {"samples": samples}}.get(
            representation["kind"], {}
        )
        body |= {"grid": grid_of(representation, grid)} if representation["kind"] == "surface" else {}
        return outlines_of(representation, (await self.calls.evaluate(cast("t.EvaluateRequest", body))).json())

    async def pca(
        self,
        shapes: Any,
        *,
        transformation: str = "similarity",
        components: int = 10,
        representation: Mapping[str, Any] | None = None,
        **further: Any,
    ) -> t.PcaAnswer:
        """Mean and principal components of shapes that are not stored, as the service answers `POST /v1/pca`.

        Parameters
        ----------
        shapes : Shapes, array or sequence of arrays
            At least two shapes.
        transformation : str
            Class of transformations that is removed.
        components : int
            Number of components at most.
        representation : mapping, optional
            Default: landmarks, as many as the shapes have.
        **further
            Further fields of the request, such as `correspondence` or `alignment`.
        """
        given = as_shapes(shapes)
        chosen = representation or representation_of("landmarks", None, None, "trigonometric", given)
        body = {
            "representation": dict(chosen),
            "transformation": transformation,
            "components": components,
            "shapes": [{"points": shape} for shape in given],
            **further,
        }
        return (await self.calls.pca(cast("t.PcaRequest", body))).json()

    async def _result(self, reply: Reply[Any], progress: bool | None) -> Any:
        """The answer of a request that may have become a job."""
        if reply.status != httpx.codes.ACCEPTED:
            return reply.json()
        return await AsyncJob(self, reply.json()).wait(progress=progress)


class AsyncCohort:
    """A named set of shapes in one representation.

    Attributes
    ----------
    client : AsyncClient
        The client.
    name : str
        Its name or id.
    """

    def __init__(self, client: AsyncClient, name: str) -> None:
        self.client, self.name = client, name
        self._representation: t.Representation | None = None

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>"

    async def info(self) -> t.CohortOutput:
        """What the service says of the cohort: number of shapes, revision, representation."""
        return (await self.client.calls.find_cohort(self.name)).json()

    async def exists(self) -> bool:
        """Whether there is such a cohort."""
        from .errors import NotFound

        try:
            await self.info()
        except NotFound:
            return False
        return True

    async def representation(self) -> t.Representation:
        """Its representation, which never changes."""
        if self._representation is None:
            self._representation = (await self.info())["representation"]
        return self._representation

    async def delete(self) -> None:
        """Moves the cohort to the trash."""
        await self.client.calls.delete_cohort(self.name)

    async def add(
        self,
        source: Any,
        *,
        ids: Texts | None = None,
        subjects: Texts | None = None,
        labels: Texts | None = None,
        weights: ArrayLike | None = None,
        attributes: Columns | None = None,
        on_error: str = "abort",
        returns: str = "none",
        **options: Any,
    ) -> Added:
        """Stores shapes of arrays or of a file; sent again, shapes of the same ids add nothing.

        Parameters
        ----------
        source : path, bytes, Shapes, array or sequence of arrays
            A file of any format of the service; an array of shape (n, p, d) or (p, d); arrays of shape (p_k, d).
        ids, subjects, labels : sequence of str, optional
            One for each shape of arrays.
        weights : array_like of shape (n,), optional
            Weights in means.
        attributes : DataFrame, mapping of columns, or sequence of mappings, optional
            Attributes of the shapes of arrays.
        on_error : {"abort", "skip"}
            What a bad shape does: it refuses all of them, or is left out and told in `faults`.
        returns : {"none", "ids"}
            Whether the ids of the stored shapes are answered.
        **options
            Options of reading a file, such as `select="heart"`, `contours="plane"` or `unit="mm"`.
        """
        asked: dict[str, Any] = {"on_error": on_error, "return_": returns}
        added, before = Added(), 0
        if is_path(source) or isinstance(source, bytes):
            body, texts = uploaded(source, options)
            reply = await self.client.calls.add_shapes(self.name, body, **asked, **texts)
            added.take(cast("Mapping[str, Any]", reply.json()), 0)
            return added
        shapes = as_shapes(
            source, ids=ids, subjects=subjects, labels=labels, weights=weights, attributes=attributes, **options
        )
        if shapes.closed is None:
            shapes = as_shapes(shapes, closed=CLOSED_KINDS.get((await self.representation())["kind"]))
        for part in shapes.parts(PART, len(shapes)):
            body, kind, said = part.body()
            reply = await self.client.calls.add_shapes(self.name, body, content_type=kind, options=said, **asked)
            added.take(cast("Mapping[str, Any]", reply.json()), before)
            before += len(part)
        return added

    async def shapes(self, *, fields: str | None = None, **conditions: Any) -> AsyncIterator[t.StoredShape]:
        """Stored shapes one by one, page after page, with their ids, attributes, measures and control points.

        Parameters
        ----------
        fields : str, optional
            Names of fields separated by commas; without `control_points` no geometry is read.
        **conditions
            Filter, such as `label="treated"`, `labels={"age": {"gte": 30}}` or `order="-measures.area"`.
        """
        listed = self.client.calls.list_shapes
        async for entry in self.client.pages(listed, self.name, fields=fields, limit=1000, **conditions):
            yield entry

    async def points(self, n: int = 128, *, content: str = "points", **conditions: Any) -> Shapes:
        """All shapes as arrays.

        Parameters
        ----------
        n : int
            Points on a curve, at equal steps of the parameter.
        content : {"points", "control_points"}
            Points on the shapes, or control points.
        **conditions
            Filter, such as `label="treated"`.
        """
        call = self.client.calls.export_cohort
        count = n if content == "points" else None
        reply = await call(self.name, format="npz", content=cast(Any, content), points=count, **conditions)
        return Shapes.of_arrays(reply.arrays())

    async def table(self, columns: Sequence[str] | str | None = None, **conditions: Any) -> pd.DataFrame:
        """A row for each shape: ids, attributes, measures, scores of dictionaries.

        Parameters
        ----------
        columns : sequence of str, optional
            Such as `external_id`, `labels.treatment`, `measures.area`, `cells.score.1`. Default: all but scores.
        **conditions
            Filter, as the fields of `filter` of the service: `label="treated"`, `labels={"age": {"gte": 30}}`.

        Returns
        -------
        DataFrame
            Transferred as Arrow.
        """
        names = columns.split(",") if isinstance(columns, str) else columns
        body = {"columns": None if names is None else list(names), "filter": filtered(conditions)}
        return (await self.client.calls.compute_table(self.name, cast("t.TableRequest", body), format="arrow")).frame()

    async def set_attributes(self, frame: pd.DataFrame, *, on_error: str = "abort") -> t.BulkAnswer:
        """Sets attributes of stored shapes.

        Parameters
        ----------
        frame : DataFrame
            A column or an index `id` or `external_id`, and a column for each attribute; missing values change nothing.
        on_error : {"abort", "skip"}
            What a row does that fits no shape.
        """
        named = frame if {"id", "external_id"} & set(frame.columns) else frame.reset_index()
        body = named.to_csv(index=False).encode()
        call = self.client.calls.set_attributes
        return (await call(self.name, body, content_type="text/csv", on_error=cast(Any, on_error))).json()

    async def mean(self, transformation: str = "similarity", *, samples: int = 200, **further: Any) -> Mean:
        """The mean shape.

        Parameters
        ----------
        transformation : str
            Class of transformations that is removed, such as `similarity`, `rigid` or `affine`.
        samples : int
            Points of `outline` on a curve.
        **further
            Parameters of the service (`alignment`, `frame`, `robust`), and a filter.
        """
        answer = await self.client.calls.cohort_mean(self.name, transformation=cast(Any, transformation), **further)
        document = answer.json()
        shape = control_points(document["mean"])
        outline = await self.client.evaluate(
            cast("Mapping[str, Any]", await self.representation()), shape[None], samples=samples
        )
        return Mean(shape, outline, document)

    async def learn(
        self,
        name: str,
        components: int = 10,
        *,
        transformation: str = "similarity",
        method: Mapping[str, Any] | None = None,
        classifier: str | Mapping[str, Any] | None = None,
        progress: bool | None = None,
        **further: Any,
    ) -> AsyncDictionary:
        """Learns a dictionary and waits for it.

        Parameters
        ----------
        name : str
            Its name; an existing one gets a new version.
        components : int
            Number of principal components at most.
        transformation : str
            Class of transformations that is removed.
        method : mapping, optional
            Another method, such as `{"kind": "sparse", "atoms": 12, "nonzeros": 3}`.
        classifier : str or mapping, optional
            Attribute that a classifier learns to tell, `label` or `labels.<attribute>`, or all its settings.
        progress : bool, optional
            Whether a bar is shown. Default: where tqdm is installed, of jobs that take more than a second.
        **further
            Further fields of the request, such as `robust`, `alignment`, `only_if_changed` or `filter`.
        """
        body = method_of(name, self.name, components, transformation, method, classifier, further)
        reply = await self.client.calls.learn_dictionary(cast("t.LearnRequest", body), prefer=WAIT)
        found = await self.client._result(reply, progress)
        return AsyncDictionary(self.client, found.get("id") or found["dictionary"])

    async def start_learning(self, name: str, components: int = 10, **further: Any) -> AsyncJob:
        """Begins to learn a dictionary as `learn` does, and returns the job at once."""
        transformation = further.pop("transformation", "similarity")
        parts = (further.pop("method", None), further.pop("classifier", None))
        body = method_of(name, self.name, components, transformation, *parts, further)
        reply = await self.client.calls.learn_dictionary(cast("t.LearnRequest", body))
        return AsyncJob(self.client, cast("t.JobOutput", reply.json()))

    async def compare(
        self,
        by: str | None = None,
        *,
        groups: Mapping[str, Mapping[str, Any]] | None = None,
        permutations: int = 1000,
        samples: int | None = None,
        progress: bool | None = None,
        **further: Any,
    ) -> Comparison:
        """Compares groups of shapes by permutation tests.

        Parameters
        ----------
        by : str, optional
            Attribute that defines the groups, `label` or `labels.<attribute>`.
        groups : mapping of filters by names, optional
            Groups in place of `by`, such as `{"old": {"labels": {"age": {"gte": 60}}}, …}`.
        permutations : int
            Number of relabellings.
        samples : int, optional
            Points along the shape at which the effect is told. Default: the number of control points.
        progress : bool, optional
            As in `learn`.
        **further
            Further fields of the request, such as `strata`, `seed` or `transformation`.
        """
        named = [{"name": name, "filter": dict(chosen)} for name, chosen in (groups or {}).items()] or None
        body = {"cohort": self.name, "by": by, "groups": named, "permutations": permutations, "samples": samples}
        reply = await self.client.calls.compare(cast("t.CompareRequest", {**body, **further}), prefer=WAIT)
        document = cast("t.Comparison", await self.client._result(reply, progress))
        averages = [group["average"] for group in document["groups"]]
        shown = cast("Mapping[str, Any]", await self.representation())
        return Comparison(document, await self.client.evaluate(shown, averages))

    async def lm(
        self,
        formula: str,
        *,
        at: Sequence[Mapping[str, Any]] | None = None,
        permutations: int = 999,
        progress: bool | None = None,
        **further: Any,
    ) -> LinearModel:
        """Fits a linear model by a formula as R reads it, and tests its terms by permutation.

        Parameters
        ----------
        formula : str
            Such as `"~ log_centroid_size * cell_line"` or `"~ treatment + (1 | subject)"`.
        at : sequence of mappings, optional
            Values at which shapes are predicted. Default: the levels or quantiles of the first variable.
        permutations : int
            Number of exchanges of residuals.
        progress : bool, optional
            As in `learn`.
        **further
            Further fields of the request, such as `type`, `blocks` or `response`.
        """
        body = {"cohort": self.name, "formula": formula, "permutations": permutations, **further}
        body |= {} if at is None else {"at": [dict(values) for values in at]}
        reply = await self.client.calls.model(cast("t.ModelRequest", body), prefer=WAIT)
        document = cast("t.ShapeModel", await self.client._result(reply, progress))
        shapes = [entry["shape"] for entry in document["predictions"] if entry.get("shape") is not None]
        shown = cast("Mapping[str, Any]", await self.representation())
        return LinearModel(document, await self.client.evaluate(shown, cast(Any, shapes)) if shapes else None)

    async def regress(self, attribute: str, *, progress: bool | None = None, **further: Any) -> t.ShapeRegression:
        """Regresses the shapes on an attribute, such as `log_centroid_size`, as `POST /v1/regressions` answers it."""
        body = {"cohort": self.name, "attribute": attribute, **further}
        reply = await self.client.calls.regress(cast("t.RegressRequest", body), prefer=WAIT)
        return cast("t.ShapeRegression", await self.client._result(reply, progress))

    async def distances(
        self, transformation: str = "similarity", *, progress: bool | None = None, **further: Any
    ) -> NDArray[np.float64]:
        """All pairwise distances, of shape (n, n), in the order of the cohort; transferred as NPY.

        Parameters
        ----------
        transformation : str
            Class of transformations that is removed.
        progress : bool, optional
            Whether a bar shows the progress of a job.
        **further
            Further fields of the request, such as `mirror` or `ids`; `correspondence="elastic"` for distances of curves
            modulo parametrisation, with `elasticity`, `points`, `rotation`, `effort`.
        """
        body = cast("t.DistancesRequest", {"cohort": self.name, "transformation": transformation, **further})
        reply = await self.client.calls.compute_distances(body, format="npy", prefer=WAIT)
        if reply.media_type == NPY:
            return reply.array()
        job = AsyncJob(self.client, cast("t.JobOutput", reply.json()))
        await job.wait(progress=progress)
        return (await self.client.calls.job_output(job.id, format="npy")).array()

    async def search(
        self, shapes: Any = None, *, ids: Sequence[str] | None = None, neighbours: int = 5, **further: Any
    ) -> pd.DataFrame:
        """Nearest shapes of the cohort, a row a neighbour, for shapes of arrays or stored ones.

        Parameters
        ----------
        shapes : Shapes, array or sequence of arrays, optional
            Shapes that are not stored.
        ids : sequence of str, optional
            Stored shapes by their ids.
        neighbours : int
            Neighbours of each.
        **further
            Further fields of the request, such as `transformation` or `mirror`.
        """
        given = None if shapes is None else [{"points": shape} for shape in as_shapes(shapes)]
        body = {"shapes": given, "ids": None if ids is None else list(ids), "neighbours": neighbours, **further}
        call = self.client.calls.search_cohort
        reply = await call(self.name, cast("t.SearchRequest", body), format="arrow", table="results.neighbours")
        return reply.frame()


class AsyncDictionary:
    """A dictionary in one of its versions: a mean shape with components or atoms, and perhaps a classifier.

    Attributes
    ----------
    client : AsyncClient
        The client.
    name : str
        Its id, `name@version`, `name@alias` or name.
    """

    def __init__(self, client: AsyncClient, name: str) -> None:
        self.client, self.name = client, name
        self._info: t.DictionaryOutput | None = None

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>"

    async def info(self) -> t.DictionaryOutput:
        """What the service says of it: mean, atoms, statistics, classifier. Asked once, and kept."""
        if self._info is None:
            self._info = (await self.client.calls.find_dictionary(self.name)).json()
            self.name = self._info["id"]
        return self._info

    async def delete(self) -> None:
        """Moves this version to the trash."""
        await self.client.calls.delete_dictionary(self.name)

    async def explained(self) -> NDArray[np.float64]:
        """Fraction of the variation that each component explains, of shape (k,)."""
        atoms = (await self.info())["atoms"]
        return np.array([atom.get("explained") or np.nan for atom in atoms], dtype=np.float64)

    async def _shape_frame(
        self,
        call: Callable[..., Awaitable[Reply[Any]]],
        shapes: Any,
        ids: Sequence[str] | None = None,
        cohort: str | None = None,
        **further: Any,
    ) -> pd.DataFrame:
        """The frame of a batch operation: of stored shapes, or of arrays in parts as the service takes them."""
        expect((shapes is None) != (ids is None), "expected shapes or ids, got " + ("both" if ids else "neither"))
        if ids is not None:
            stored = {"cohort": cohort or (await self.info())["cohort"], "ids": list(ids)}
            return (await call(self.name, stored, format="arrow", **further)).frame()
        pandas, frames = imported("pandas", "a frame"), []
        kind = (await self.info())["representation"]["kind"]
        given = as_shapes(shapes)
        if given.closed is None:
            given = as_shapes(given, closed=CLOSED_KINDS.get(kind))
        before = 0
        for part in given.parts():
            body, media_type, said = part.body()
            reply = await call(self.name, body, content_type=media_type, options=said, format="arrow", **further)
            frame = reply.frame()
            frame["index"] += before
            frames.append(frame)
            before += len(part)
        return cast("pd.DataFrame", pandas.concat(frames, ignore_index=True) if len(frames) > 1 else frames[0])

    async def scores(
        self, shapes: Any = None, *, cohort: str | None = None, columns: Iterable[str] = (), **conditions: Any
    ) -> pd.DataFrame:
        """Scores of shapes, a row a shape.

        Parameters
        ----------
        shapes : Shapes, array or sequence of arrays, optional
            Shapes that are not stored. Default: those of a cohort.
        cohort : str, optional
            Cohort of the shapes. Default: the one that the dictionary was learnt from.
        columns : iterable of str
            Further columns of a cohort, such as `labels.age` or `measures.area`.
        **conditions
            Filter of the shapes of a cohort.

        Returns
        -------
        DataFrame
            `external_id`, `label`, `score.1`, …, `t_squared`, `residual`, `outlier` and what `columns` says of stored
            shapes; of arrays, `index`, `score.1`, … and `novelty.…`. Scores of shapes of unit norm have no unit.
        """
        if shapes is not None:
            return scores_of(await self._shape_frame(self.client.calls.score, shapes))
        document = await self.info()
        said = [f"{self.name}.score.{k + 1}" for k in range(len(document["atoms"]))]
        said += [f"{self.name}.{word}" for word in ("t_squared", "residual", "outlier")]
        wanted = list(dict.fromkeys(["external_id", "label", *columns, *said]))
        frame = await AsyncCohort(self.client, cohort or document["cohort"]).table(wanted, **conditions)
        named = {name: name.removeprefix(f"{self.name}.") for name in said}
        renamed: pd.DataFrame = frame.rename(columns=named)
        return renamed

    async def codes(
        self, shapes: Any = None, *, ids: Sequence[str] | None = None, cohort: str | None = None
    ) -> pd.DataFrame:
        """Sparse codes, a row a shape: `indices` and `values` of the atoms, `relative_error`.

        Parameters
        ----------
        shapes : Shapes, array or sequence of arrays, optional
            Shapes that are not stored.
        ids : sequence of str, optional
            Stored shapes by their ids, in place of `shapes`.
        cohort : str, optional
            Cohort of the stored shapes. Default: the one that the dictionary was learnt from.
        """
        return await self._shape_frame(self.client.calls.encode, shapes, ids, cohort)

    async def classify(
        self, shapes: Any = None, *, ids: Sequence[str] | None = None, cohort: str | None = None
    ) -> pd.DataFrame:
        """Classes of shapes as `codes` takes them, a row a shape: `label`, `margin`, `accepted`, `ranking` of all."""
        return await self._shape_frame(self.client.calls.classify, shapes, ids, cohort)

    async def assess(
        self, shapes: Any = None, *, ids: Sequence[str] | None = None, cohort: str | None = None, **further: Any
    ) -> pd.DataFrame:
        """Assessments of shapes as `codes` takes them, a row a shape: class, scores, whether it is an outlier."""
        return await self._shape_frame(self.client.calls.assess, shapes, ids, cohort, **further)

    async def sample(self, count: int = 10, *, seed: int = 0) -> NDArray[np.float64]:
        """Control points of random shapes, of shape (count, N, d)."""
        reply = await self.client.calls.sample(self.name, {"count": count, "seed": seed})
        return np.array([control_points(cast("dict[str, Any]", shape)) for shape in reply.json()["shapes"]])

    async def shapes_at(self, scores: ArrayLike) -> NDArray[np.float64]:
        """Control points of the shapes at given scores.

        Parameters
        ----------
        scores : array_like of shape (n, j)
            Scores of the first `j` components.

        Returns
        -------
        ndarray of shape (n, N, d)
            Centre plus the eigenshapes times the scores.
        """
        document = await self.info()
        expect(document.get("centre") is not None, "expected a dictionary of centred components, got one of atoms")
        rows = np.atleast_2d(np.asarray(scores, dtype=np.float64))
        atoms = np.array([atom["control_points"] for atom in document["atoms"]], dtype=np.float64)
        expect(rows.shape[1] <= len(atoms), f"expected at most {len(atoms)} scores of a shape, got {rows.shape[1]}")
        centre = np.asarray(document["centre"], dtype=np.float64)
        return np.asarray(centre + np.tensordot(rows, atoms[: rows.shape[1]], axes=1), dtype=np.float64)

    async def modes(
        self, components: int | Sequence[int] = 3, *, sigmas: Sequence[float] = (-2, -1, 0, 1, 2), samples: int = 200
    ) -> Modes:
        """Shapes along the modes of variation.

        Parameters
        ----------
        components : int or sequence of int
            Number of leading components, or these components, from 1.
        sigmas : sequence of float
            Standard deviations of the scores at which shapes are taken.
        samples : int
            Points on a curve.
        """
        document, explained = await self.info(), await self.explained()
        known = len(document["atoms"])
        chosen = list(range(1, min(components, known) + 1)) if isinstance(components, int) else list(components)
        expect(all(1 <= k <= known for k in chosen), f"expected components from 1 to {known}, got {chosen}")
        spread = await self.deviations()
        scores = np.zeros((len(chosen) * len(sigmas) + 1, known))
        for row, k in enumerate(chosen):
            scores[row * len(sigmas) : (row + 1) * len(sigmas), k - 1] = np.asarray(sigmas) * spread[k - 1]
        representation = cast("Mapping[str, Any]", document["representation"])
        drawn = await self.client.evaluate(representation, await self.shapes_at(scores), samples=samples)
        steps = [drawn[row * len(sigmas) : (row + 1) * len(sigmas)] for row in range(len(chosen))]
        places = np.array(chosen) - 1
        levels = np.asarray(sigmas, dtype=np.float64)
        return Modes(drawn[-1], steps, levels, chosen, explained[places], spread[places])

    async def deviations(self) -> NDArray[np.float64]:
        """Standard deviations of the scores of the training shapes, of shape (k,)."""
        known = (await self.info())["statistics"].get("scores")
        expect(known is not None, "expected a dictionary of components, got one of sparse atoms")
        return np.sqrt(np.diag(np.asarray(cast(Any, known)["covariance"], dtype=np.float64)))

    async def plot(self, components: int | Sequence[int] = 3, **style: Any) -> Any:
        """Draws the modes of variation as a figure of matplotlib."""
        return (await self.modes(components)).plot(**style)

    async def morphospace(
        self, components: tuple[int, int] = (1, 2), *, steps: int = 5, samples: int = 100, **chosen: Any
    ) -> Morphospace:
        """Scores of the shapes on two components, and shapes on a grid of scores.

        Parameters
        ----------
        components : (int, int)
            Components along x and y, from 1.
        steps : int
            Shapes along each axis.
        samples : int
            Points on a curve.
        **chosen
            As `scores` takes it: `cohort`, `columns`, a filter.
        """
        frame, document, explained = await self.scores(**chosen), await self.info(), await self.explained()
        ends = [(float(frame[f"score.{k}"].min()), float(frame[f"score.{k}"].max())) for k in components]
        x, y = np.meshgrid(*(np.linspace(low, high, steps) for low, high in ends))
        at = np.stack([x.ravel(), y.ravel()], axis=1)
        scores = np.zeros((len(at), len(document["atoms"])))
        scores[:, [k - 1 for k in components]] = at
        representation = cast("Mapping[str, Any]", document["representation"])
        outlines = await self.client.evaluate(representation, await self.shapes_at(scores), samples=samples)
        return Morphospace(frame, components, at, outlines, explained[[k - 1 for k in components]])


class AsyncJob:
    """A long-running computation of the service.

    Attributes
    ----------
    document : JobOutput
        What the service said of it last.
    """

    def __init__(self, client: AsyncClient, document: t.JobOutput) -> None:
        self.client, self.document = client, document

    @property
    def id(self) -> str:
        """Its id."""
        return self.document["id"]

    @property
    def status(self) -> str:
        """`queued`, `running`, `succeeded`, `failed` or `cancelled`, as the service said last."""
        return self.document["status"]

    @property
    def progress(self) -> float:
        """Fraction that is done, from 0 to 1."""
        return self.document["progress"]

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.document['kind']} {self.id}: {self.status}, {self.progress:.0%}>"

    async def refresh(self) -> Self:
        """Asks the service again."""
        self.document = (await self.client.calls.find_job(self.id)).json()
        return self

    async def cancel(self) -> Self:
        """Cancels it."""
        self.document = (await self.client.calls.cancel_job(self.id)).json()
        return self

    async def wait(self, *, timeout: float | None = None, progress: bool | None = None) -> Any:
        """Waits until it ends.

        Parameters
        ----------
        timeout : float, optional
            Seconds after which `TimeoutError` is raised; the job runs on.
        progress : bool, optional
            Whether a bar is shown. Default: where tqdm is installed, after a second.

        Returns
        -------
        dict
            Its result.

        Raises
        ------
        JobFailed
            With the problem that the job keeps.
        JobCancelled
            When it was cancelled.
        """
        with Progress(self.document["kind"], progress, timeout) as shown:
            pause = FIRST_LOOK
            while self.status in ("queued", "running"):
                shown.update(self.progress, self.document.get("phase"))
                await asyncio.sleep(shown.within(pause, self.id))
                pause = min(pause * 1.5, LAST_LOOK)
                await self.refresh()
            shown.update(self.progress, None)
        if self.status == "cancelled":
            raise JobCancelled(f"expected the result of {self.id}, got a job that was cancelled")
        if self.status == "failed":
            raise problem(cast("dict[str, Any]", self.document.get("problem") or {}), JobFailed)
        if "result" not in self.document:
            await self.refresh()
        return self.document.get("result")

    async def output(self, format: str | None = None) -> Reply[Any]:
        """The output of a job that has one, such as lines of assessments or a matrix."""
        return await self.client.calls.job_output(self.id, format=format)
