"""Estimators of scikit-learn that learn with the service.

`X` is an array of shape (n_shapes, n_points, d), or (n_shapes, n_points · d) with points row by row, as scikit-learn
wants arrays of two axes; `dimension` is `d` then. All shapes have as many points. With `kind="closed_curve"` they are
points on contours, of which the service makes splines.
"""

from __future__ import annotations

import json
import uuid
import weakref
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from ._helpers import CLOSED_KINDS, method_of, representation_of
from ._reply import imported
from ._shapes import Shapes, as_shapes
from ._sync import Client, Dictionary
from .errors import NotFound, ShapelexError

# Before the classes, so that the refusal names the package.
imported("sklearn", "an estimator")

from sklearn.base import (  # noqa: E402
    BaseEstimator,
    ClassifierMixin,
    ClassNamePrefixFeaturesOutMixin,
    OneToOneFeatureMixin,
    TransformerMixin,
)
from sklearn.utils.multiclass import check_classification_targets  # noqa: E402
from sklearn.utils.validation import check_is_fitted, validate_data  # noqa: E402

if TYPE_CHECKING:
    from ._generated import types as t

Floats = NDArray[np.float64]


@lru_cache(maxsize=16)
def client_of(url: str | None) -> Client:
    """The client of an address, made once: estimators are cloned and pickled, connections are not."""
    return Client(url)


class _ShapeEstimator(BaseEstimator):  # type: ignore[misc]
    """What the estimators share: their shapes, their representation, and how the service is asked.

    Source of the parameters: `Client.create_cohort`.
    """

    def __init__(
        self,
        *,
        transformation: str = "similarity",
        kind: str = "landmarks",
        dimension: int = 2,
        control_points: int | None = None,
        generator: str = "trigonometric",
        correspondence: str = "landmarks",
        url: str | None = None,
    ) -> None:
        self.transformation = transformation
        self.kind = kind
        self.dimension = dimension
        self.control_points = control_points
        self.generator = generator
        self.correspondence = correspondence
        self.url = url

    def _checked(self, X: Any, *, reset: bool, y: Any = None) -> tuple[Floats, Any]:
        """Arrays of two axes, checked as scikit-learn checks them; and the targets."""
        array = X
        if isinstance(X, np.ndarray) and X.ndim == 3:
            if X.shape[2] != self.dimension:
                raise ValueError(f"expected points of {self.dimension} coordinates (dimension), got {X.shape[2]}")
            array = X.reshape(len(X), -1)
        wanted = {"dtype": np.float64, "reset": reset, "ensure_min_samples": 2 if reset else 1}
        if y is None:
            array = validate_data(self, array, **wanted)
        else:
            array, y = validate_data(self, array, y, **wanted)
        return array, y

    def _shapes(self, X: Any, *, reset: bool) -> Shapes:
        """Shapes of an array of two or three axes."""
        return self._as_shapes(self._checked(X, reset=reset)[0])

    def _as_shapes(self, array: Floats) -> Shapes:
        n_features = array.shape[1]
        if n_features % self.dimension or n_features < 2 * self.dimension:
            raise ValueError(
                f"expected n_features to be the number of points (at least 2) times the dimension {self.dimension}, "
                f"got n_features={n_features}"
            )
        return Shapes(array.reshape(len(array), -1, self.dimension))

    def _representation(self, shapes: Shapes) -> dict[str, Any]:
        count = None if self.kind == "landmarks" else self.control_points
        return representation_of(self.kind, count, None, self.generator, shapes)

    def _client(self) -> Client:
        return client_of(self.url)

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.three_d_array = True
        return tags


class ShapeAligner(OneToOneFeatureMixin, TransformerMixin, _ShapeEstimator):  # type: ignore[misc]
    """Alignment of shapes to their mean.

    `transform` gives the member of the class of each shape that lies nearest to the mean, in the unit of the mean.

    Parameters
    ----------
    transformation : str
        Class of transformations that is removed, such as `similarity`, `rigid` or `affine`.
    kind : {"landmarks", "closed_curve", "open_curve"}
        Kind of the shapes.
    dimension : int
        Coordinates of a point, 2 or 3.
    control_points : int, optional
        Control points of curves. Default: 32. Of curves, `transform` answers control points.
    generator : str
        Generator of the curves.
    correspondence : {"landmarks", "arc_length", "cyclic"}
        How points of two shapes correspond.
    url : str, optional
        Address of the service. Default: as `Client` has it.

    Attributes
    ----------
    mean_ : ndarray of shape (N, d)
        Control points of the mean; of landmarks the points.
    representation_ : dict
        Representation of the shapes.
    n_features_in_ : int
        Points times coordinates of a shape.
    """

    def fit(self, X: Any, y: Any = None) -> Self:
        """Computes the mean.

        Parameters
        ----------
        X : array_like of shape (n_shapes, n_points, d) or (n_shapes, n_points · d)
            Shapes.
        y : ignored
        """
        shapes = self._shapes(X, reset=True)
        self.representation_ = self._representation(shapes)
        body = {
            "representation": self.representation_,
            "correspondence": self.correspondence,
            "transformation": self.transformation,
            "shapes": [{"points": shape} for shape in shapes],
        }
        answer = self._client().calls.mean(cast("t.StatisticsRequest", body)).json()
        self.mean_ = np.asarray(answer["mean"]["control_points"], dtype=np.float64)
        return self

    def transform(self, X: Any) -> Floats:
        """Aligns shapes to the mean.

        Parameters
        ----------
        X : array_like of shape (n_shapes, n_points, d) or (n_shapes, n_points · d)
            Shapes.

        Returns
        -------
        ndarray of shape (n_shapes, N · d)
            Control points of the aligned shapes, row by row; of landmarks the points.
        """
        check_is_fitted(self)
        shapes = self._shapes(X, reset=False)
        settings = {
            "representation": self.representation_,
            "correspondence": self.correspondence,
            "transformation": self.transformation,
            "reference": {"control_points": self.mean_},
            "onto": "shape",
        }
        found = []
        for part in shapes.parts():
            body = {**settings, "shapes": [{"points": shape} for shape in part]}
            reply = self._client().calls.project(cast(Any, body), format="npy", column="control_points")
            found.append(reply.array().reshape(len(part), -1))
        return np.concatenate(found)

    def get_feature_names_out(self, input_features: Any = None) -> NDArray[Any]:
        """Names of the columns: those of the input for landmarks, `shapealigner0`, … for curves."""
        if getattr(self, "kind", "") == "landmarks":
            return cast("NDArray[Any]", super().get_feature_names_out(input_features))
        check_is_fitted(self)
        return np.array([f"shapealigner{k}" for k in range(self.mean_.size)], dtype=object)


class _Learnt(_ShapeEstimator):
    """What learns a dictionary, and keeps it as a document that any service can take in again."""

    def _learn(self, shapes: Shapes, labels: list[str] | None, components: int, classifier: Any) -> None:
        client, name = self._client(), f"sklearn-{uuid.uuid4().hex}"
        self.representation_ = self._representation(shapes)
        cohort = client.create_cohort(name, representation=self.representation_, correspondence=self.correspondence)
        try:
            cohort.add(as_shapes(shapes, labels=labels))
            body = method_of(name, name, components, self.transformation, None, classifier, {})
            reply = client.calls.learn_dictionary(cast("t.LearnRequest", body), prefer="wait=60")
            learnt = client._result(reply, False)
            dictionary = Dictionary(client, learnt.get("id") or learnt["dictionary"])
            self.dictionary_ = client.calls.export_dictionary(dictionary.name).json()
            self._keep(dictionary)
        finally:
            cohort.delete()

    def _keep(self, dictionary: Dictionary) -> None:
        """Remembers the dictionary, which is removed from the service with this estimator."""
        self._known = dictionary
        weakref.finalize(self, forget, dictionary)

    def _dictionary(self) -> Dictionary:
        """The dictionary on the service; it is taken there again where it is missing, as after unpickling."""
        known: Dictionary | None = getattr(self, "_known", None)
        if known is None:
            name = f"sklearn-{uuid.uuid4().hex}"
            answer = self._client().calls.import_dictionary(self.dictionary_, name=name).json()
            known = Dictionary(self._client(), answer["id"])
            self._keep(known)
        return known

    def __getstate__(self) -> dict[str, Any]:
        state = dict(super().__getstate__())
        state.pop("_known", None)
        return state

    def _asked(self, call: Any, shapes: Shapes, **wanted: Any) -> list[Any]:
        """Replies to the shapes, part by part."""
        name, found = self._dictionary().name, []
        for part in as_shapes(shapes, closed=CLOSED_KINDS.get(self.kind)).parts():
            body, media_type, said = part.body()
            found.append(call(name, body, content_type=media_type, options=said, **wanted))
        return found


class ShapePCA(ClassNamePrefixFeaturesOutMixin, TransformerMixin, _Learnt):  # type: ignore[misc]
    """Principal components of shapes, after what a class of transformations does to them is removed.

    Parameters
    ----------
    n_components : int, optional
        Number of components at most. Default: 10.
    transformation, kind, dimension, control_points, generator, correspondence, url
        As in `ShapeAligner`.

    Attributes
    ----------
    components_ : ndarray of shape (n_components, N · d)
        Eigenshapes, orthonormal in `L₂`: their control points row by row.
    mean_ : ndarray of shape (N, d)
        Arithmetic mean of the aligned shapes.
    explained_variance_ : ndarray of shape (n_components,)
        Variances of the scores.
    explained_variance_ratio_ : ndarray of shape (n_components,)
        Fraction of the variation that each component explains.
    dictionary_ : dict
        The dictionary as the service exports it: a fitted estimator can be pickled and used with another service.
    """

    def __init__(
        self,
        n_components: int = 10,
        *,
        transformation: str = "similarity",
        kind: str = "landmarks",
        dimension: int = 2,
        control_points: int | None = None,
        generator: str = "trigonometric",
        correspondence: str = "landmarks",
        url: str | None = None,
    ) -> None:
        super().__init__(
            transformation=transformation,
            kind=kind,
            dimension=dimension,
            control_points=control_points,
            generator=generator,
            correspondence=correspondence,
            url=url,
        )
        self.n_components = n_components

    def fit(self, X: Any, y: Any = None) -> Self:
        """Learns mean and components.

        Parameters
        ----------
        X : array_like of shape (n_shapes, n_points, d) or (n_shapes, n_points · d)
            Shapes.
        y : ignored
        """
        shapes = self._shapes(X, reset=True)
        self._learn(shapes, None, self.n_components, None)
        found = self._dictionary().info()
        self.mean_ = np.asarray(found["centre"], dtype=np.float64)
        self.components_ = np.array([np.ravel(atom["control_points"]) for atom in found["atoms"]])
        self.explained_variance_ = self._dictionary().deviations() ** 2
        self.explained_variance_ratio_ = self._dictionary().explained()
        return self

    def transform(self, X: Any) -> Floats:
        """Scores of shapes.

        Parameters
        ----------
        X : array_like of shape (n_shapes, n_points, d) or (n_shapes, n_points · d)
            Shapes.

        Returns
        -------
        ndarray of shape (n_shapes, n_components)
            Scores.
        """
        check_is_fitted(self)
        shapes = self._shapes(X, reset=False)
        replies = self._asked(self._client().calls.score, shapes, format="npy", column="scores")
        return np.concatenate([reply.array() for reply in replies])

    def inverse_transform(self, X: Any) -> Floats:
        """Shapes at scores.

        Parameters
        ----------
        X : array_like of shape (n_shapes, n_components)
            Scores.

        Returns
        -------
        ndarray of shape (n_shapes, N · d)
            Control points row by row, in the pose of the mean; of landmarks the points.
        """
        check_is_fitted(self)
        return np.asarray(self.mean_.ravel() + np.asarray(X, dtype=np.float64) @ self.components_, dtype=np.float64)

    @property
    def _n_features_out(self) -> int:
        return len(self.components_)


class ShapeClassifier(ClassifierMixin, _Learnt):  # type: ignore[misc]
    """Classes of shapes.

    Parameters
    ----------
    classifier : str
        Kind of the classifier, such as `discriminant`, `nearest_neighbours` or `best`.
    n_components : int
        Number of components of the shapes at most.
    transformation, kind, dimension, control_points, generator, correspondence, url
        As in `ShapeAligner`.

    Attributes
    ----------
    classes_ : ndarray of shape (n_classes,)
        The classes.
    dictionary_ : dict
        The dictionary with its classifier, as the service exports it.
    """

    def __init__(
        self,
        classifier: str = "discriminant",
        *,
        n_components: int = 10,
        transformation: str = "similarity",
        kind: str = "landmarks",
        dimension: int = 2,
        control_points: int | None = None,
        generator: str = "trigonometric",
        correspondence: str = "landmarks",
        url: str | None = None,
    ) -> None:
        super().__init__(
            transformation=transformation,
            kind=kind,
            dimension=dimension,
            control_points=control_points,
            generator=generator,
            correspondence=correspondence,
            url=url,
        )
        self.classifier = classifier
        self.n_components = n_components

    def fit(self, X: Any, y: Any) -> Self:
        """Learns the classes.

        Parameters
        ----------
        X : array_like of shape (n_shapes, n_points, d) or (n_shapes, n_points · d)
            Shapes.
        y : array_like of shape (n_shapes,)
            Their classes.
        """
        if y is None:
            raise ValueError(f"{type(self).__name__} requires y to be passed, but the target y is None")
        array, y = self._checked(X, reset=True, y=y)
        check_classification_targets(y)
        self.classes_, places = np.unique(y, return_inverse=True)
        if len(self.classes_) < 2:
            raise ValueError(f"expected at least 2 classes, got 1 class: {self.classes_[0]!r}")
        labels = [str(place) for place in places]
        self._learn(self._as_shapes(array), labels, self.n_components, {"kind": self.classifier, "attribute": "label"})
        return self

    def predict_proba(self, X: Any) -> Floats:
        """Confidences of the classes.

        Parameters
        ----------
        X : array_like of shape (n_shapes, n_points, d) or (n_shapes, n_points · d)
            Shapes.

        Returns
        -------
        ndarray of shape (n_shapes, n_classes)
            Confidences, which sum to one, in the order of `classes_`.
        """
        check_is_fitted(self)
        shapes = self._shapes(X, reset=False)
        found = np.zeros((len(shapes), len(self.classes_)))
        rows = (row for reply in self._asked(self._client().calls.classify, shapes) for row in reply.json()["results"])
        for place, row in enumerate(rows):
            for entry in row["ranking"]:
                found[place, int(entry["label"])] = entry["confidence"]
        return found

    def predict(self, X: Any) -> NDArray[Any]:
        """Most likely classes.

        Parameters
        ----------
        X : array_like of shape (n_shapes, n_points, d) or (n_shapes, n_points · d)
            Shapes.

        Returns
        -------
        ndarray of shape (n_shapes,)
            Members of `classes_`.
        """
        confidences = self.predict_proba(X)
        return np.asarray(self.classes_[confidences.argmax(axis=1)])


def forget(dictionary: Dictionary) -> None:
    """Removes the dictionary of an estimator that is gone; a service that is gone too has none."""
    try:
        dictionary.delete()
    except (NotFound, ShapelexError, json.JSONDecodeError, RuntimeError):
        pass
