"""Estimators of scikit-learn, by the checks of scikit-learn and in its pipelines."""

import pickle

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.decomposition import PCA
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.utils import estimator_checks
from sklearn.utils.estimator_checks import parametrize_with_checks

from shapelex import Server
from shapelex.estimators import ShapeAligner, ShapeClassifier, ShapePCA, client_of
from shapelex.testing import example_shapes


@pytest.fixture(autouse=True)
def default_service(shapelex_server, monkeypatch):
    """Estimators without `url` ask the service of the tests."""
    monkeypatch.setenv("SHAPELEX_SERVER", shapelex_server.url)
    client_of.cache_clear()


ESTIMATORS = [
    ShapeAligner(transformation="translation"),
    ShapePCA(n_components=2, transformation="translation"),
    ShapeClassifier(transformation="translation"),
]

# Checks of scikit-learn whose data have 2, 3 or 5 features: one point of the plane, or half a point too many.
CANNOT_APPLY = "their data have 2, 3 or 5 features, which are no shape of at least two points of the plane"
EXPECTED_FAILED_CHECKS = dict.fromkeys(
    [
        "check_classifier_data_not_an_array",
        "check_classifiers_classes",
        "check_classifiers_train",
        "check_dict_unchanged",
        "check_dont_overwrite_parameters",
        "check_estimators_dtypes",
        "check_estimators_fit_returns_self",
        "check_estimators_nan_inf",
        "check_estimators_overwrite_params",
        "check_estimators_pickle",
        "check_f_contiguous_array_estimator",
        "check_fit2d_predict1d",
        "check_fit_check_is_fitted",
        "check_fit_idempotent",
        "check_fit_score_takes_y",
        "check_methods_sample_order_invariance",
        "check_methods_subset_invariance",
        "check_n_features_in",
        "check_pipeline_consistency",
        "check_readonly_memmap_input",
        "check_supervised_y_2d",
        "check_transformer_data_not_an_array",
        "check_transformer_general",
        "check_transformer_preserve_dtypes",
    ],
    CANNOT_APPLY,
)


def name_of(check):
    """Name of a check, which may be given with some of its arguments."""
    return check.func.__name__ if hasattr(check, "func") else check.__name__


def widened(X):
    """Data of a check as shapes: as many features again, which are seven, so that translations leave all of it."""
    return np.hstack([X, np.full_like(X, 7)]) if X.ndim == 2 and X.shape[1] in (2, 3, 5) else X


@parametrize_with_checks(ESTIMATORS)
def test_checks_of_scikit_learn(estimator, check):
    if name_of(check) in EXPECTED_FAILED_CHECKS:
        with pytest.raises(ValueError, match="expected n_features to be the number of points"):
            check(estimator)
    else:
        check(estimator)


def checks_that_cannot_apply():
    """These checks with their estimators."""
    found = [pair for one in ESTIMATORS for pair in estimator_checks.estimator_checks_generator(one)]
    return [pair for pair in found if name_of(pair[1]) in EXPECTED_FAILED_CHECKS]


@pytest.mark.parametrize(("estimator", "check"), checks_that_cannot_apply(), ids=lambda part: getattr(part, "kind", ""))
def test_checks_that_cannot_apply_pass_with_data_that_are_shapes(estimator, check, monkeypatch):
    original = estimator_checks._enforce_estimator_tags_X
    monkeypatch.setattr(
        estimator_checks, "_enforce_estimator_tags_X", lambda *given, **named: widened(original(*given, **named))
    )
    check(estimator)


def shapes():
    found = example_shapes(count=60, points=12)
    return found.points, np.array(found.labels)


def test_aligned_shapes_lie_on_the_mean():
    X, _ = shapes()
    aligner = ShapeAligner().fit(X)
    aligned = aligner.transform(X).reshape(X.shape)
    assert np.linalg.norm(aligned - aligner.mean_, axis=(1, 2)).max() < 0.6 * np.linalg.norm(aligner.mean_)
    moved = 3 * X @ np.array([[0.6, -0.8], [0.8, 0.6]]) + 7
    assert np.allclose(aligner.transform(moved).reshape(X.shape), aligned, atol=1e-9)


def test_arrays_of_two_axes_are_the_same_shapes():
    X, _ = shapes()
    flat = X.reshape(len(X), -1)
    assert np.array_equal(ShapePCA(3).fit_transform(X), ShapePCA(3).fit_transform(flat))


def test_components_are_those_of_the_aligned_shapes():
    X, _ = shapes()
    pca = ShapePCA(4).fit(X)
    scores = pca.transform(X)
    assert np.allclose(np.cov(scores.T), np.diag(pca.explained_variance_), atol=1e-9)
    # Landmarks: the metric is 1/N.
    gram = pca.components_ @ pca.components_.T / X.shape[1]
    assert np.allclose(gram, np.eye(4), atol=1e-9)
    back = pca.inverse_transform(scores)
    assert np.allclose((back - pca.mean_.ravel()) @ pca.components_.T / X.shape[1], scores, atol=1e-9)
    # The same variation as plain components of what the aligner makes, up to the scale of each shape.
    aligned = ShapeAligner().fit_transform(X)
    ratio = PCA(4).fit(aligned).explained_variance_ratio_
    assert np.allclose(ratio, pca.explained_variance_ratio_, atol=0.05)


def test_contours_are_compared_whatever_their_start():
    found = example_shapes(count=40, points=50)
    X = np.stack([np.roll(shape, 7 * k, axis=0) for k, shape in enumerate(found.points)])
    pca = ShapePCA(3, kind="closed_curve", control_points=16, correspondence="cyclic")
    assert pca.fit_transform(X).shape == (40, 3) and pca.mean_.shape == (16, 2)
    assert pca.explained_variance_ratio_.sum() > 0.7


def test_classes_are_found_and_confidences_sum_to_one():
    X, y = shapes()
    classifier = ShapeClassifier(n_components=5)
    assert cross_val_score(classifier, X.reshape(len(X), -1), y, cv=3).mean() > 0.9
    proba = classifier.fit(X, y).predict_proba(X)
    assert np.allclose(proba.sum(axis=1), 1) and classifier.score(X, y) > 0.9


def test_pipelines_clones_and_pickles():
    X, y = shapes()
    pipeline = make_pipeline(ShapePCA(5), LogisticRegression()).fit(X, y)
    assert pipeline.score(X, y) > 0.9
    again = pickle.loads(pickle.dumps(pipeline))
    assert np.array_equal(again.predict(X), pipeline.predict(X))
    assert clone(pipeline[0]).get_params() == pipeline[0].get_params()
    assert list(pipeline[0].get_feature_names_out()) == [f"shapepca{k}" for k in range(len(pipeline[0].components_))]


def test_a_fitted_estimator_is_used_with_another_service(monkeypatch):
    X, _ = shapes()
    pca = ShapePCA(3).fit(X)
    expected, document = pca.transform(X), pickle.dumps(pca)
    with Server.start() as server:
        monkeypatch.setenv("SHAPELEX_SERVER", server.url)
        client_of.cache_clear()
        assert np.allclose(pickle.loads(document).transform(X), expected, atol=1e-12)


def test_nothing_is_left_on_the_service(shapelex_client):
    X, _ = shapes()
    pca = ShapePCA(3).fit(X)
    name = pca.dictionary_["name"]
    assert not shapelex_client.cohort(name).exists()
    assert list(shapelex_client.dictionaries(name=name))
    del pca
    __import__("gc").collect()
    assert not list(shapelex_client.dictionaries(name=name))


def test_what_is_no_shape_is_refused():
    with pytest.raises(ValueError, match="expected n_features to be the number of points"):
        ShapePCA().fit(np.zeros((5, 7)))
    with pytest.raises(ValueError, match=r"expected points of 2 coordinates \(dimension\), got 3"):
        ShapePCA().fit(np.zeros((5, 7, 3)))
