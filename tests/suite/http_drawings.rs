//! Drawings over HTTP: weight, settings of the viewer, what is refused.

use reqwest::Method;
use reqwest::header::ACCEPT;
use serde_json::{Value, json};

use crate::server::{Reply, Server, Setting};

const CELLS: &str = "/v1/cohorts/example-cells";

fn landmarks(seed: usize) -> Value {
    let at =
        |k: usize| [(k * k) as f64 + 0.1 * (seed * k % 3) as f64, (3 * k) as f64 - 0.2 * (seed % 4) as f64];
    json!({"points": (0..5).map(at).collect::<Vec<_>>(), "external_id": format!("l{seed}")})
}

/// A server with the example cohort, a dictionary of it, and a cohort of landmarks in millimetres.
fn server() -> Server {
    let server = Setting::fresh().with_example().start();
    let dictionary = json!({"name": "cells", "cohort": "example-cells", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 4}});
    let request =
        server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=50").json(&dictionary);
    server.send(request).expect(201);
    let cohort = json!({"name": "marks", "correspondence": "landmarks", "length_unit": "mm",
        "representation": {"kind": "landmarks", "dimension": 2, "points": 5}});
    server.post("/v1/cohorts", &cohort).expect(201);
    let shapes: Vec<Value> = (0..12).map(landmarks).collect();
    server.post("/v1/cohorts/marks/shapes", &json!({ "shapes": shapes })).expect(201);
    server
}

/// Every route that draws, with a body where one is posted.
fn drawn() -> Vec<(&'static str, Option<Value>)> {
    let curve = json!({"kind": "closed_curve", "dimension": 2, "control_points": 4,
        "generator": {"name": "trigonometric"}});
    let ring = |a: f64, b: f64| json!({"points": [[a, 0.0], [0.0, b], [-a, 0.5], [0.0, -b]]});
    let shapes = json!([ring(2.0, 1.0), ring(1.0, 1.5), ring(1.2, 0.7)]);
    let statistics = json!({"representation": curve, "transformation": "similarity", "shapes": shapes});
    let morph = json!({"representation": curve, "from": ring(2.0, 1.0), "to": ring(1.0, 3.0)});
    let polyline = json!({"scheme": "normal_based", "level": 3, "polyline": {"points": [[0, 0], [2, 0], [2, 1], [0, 1]]}});
    vec![
        ("/v1/cohorts/example-cells/mean?transformation=similarity", None),
        ("/v1/cohorts/marks/shapes/l1", None),
        ("/v1/dictionaries/cells/atoms", None),
        ("/v1/dictionaries/cells/modes?component=2&sigma=1.5", None),
        ("/v1/generators/keys?control_points=8", None),
        ("/v1/mean", Some(statistics.clone())),
        ("/v1/align", Some(statistics.clone())),
        ("/v1/pca?component=1", Some(statistics)),
        ("/v1/evaluate", Some(json!({"representation": curve, "shapes": shapes}))),
        ("/v1/morph", Some(morph)),
        ("/v1/subdivide", Some(polyline)),
        (
            "/v1/comparisons",
            Some(json!({"cohort": "example-cells", "by": "labels.treatment", "permutations": 19})),
        ),
        (
            "/v1/regressions",
            Some(json!({"cohort": "example-cells", "attribute": "log_centroid_size", "permutations": 19})),
        ),
        (
            "/v1/models",
            Some(json!({"cohort": "example-cells", "formula": "~ cell_line", "permutations": 19})),
        ),
        (
            "/v1/models",
            Some(
                json!({"cohort": "example-cells", "formula": "~ cell_line", "permutations": 19, "bands": 0.9,
                "pairs": {"groups": ["cell_line"]}}),
            ),
        ),
        (
            "/v1/models/compare",
            Some(
                json!({"cohort": "example-cells", "reduced": "~ 1", "full": "~ cell_line", "permutations": 19}),
            ),
        ),
        (
            "/v1/repeatability",
            Some(json!({"cohort": "example-cells", "subject": "labels.cell_line", "bootstrap": 19})),
        ),
        (
            "/v1/two-blocks",
            Some(
                json!({"cohort": "example-cells", "x": {"range": [0, 0.49]}, "y": {"range": [0.5, 0.99]}, "permutations": 19}),
            ),
        ),
        (
            "/v1/modularity",
            Some(
                json!({"cohort": "marks", "modules": {"a": {"points": [0, 1]}, "b": {"points": [2, 3, 4]}}, "permutations": 19}),
            ),
        ),
        (
            "/v1/match",
            Some(
                json!({"representation": {"kind": "closed_curve", "dimension": 2, "control_points": 16, "generator": {"name": "cubic"}},
                "shapes": [{"points": [[0, 0], [4, 0], [4, 1], [0, 1]]}, {"points": [[0, 0], [3, 0], [3, 2], [0, 1]]}]}),
            ),
        ),
        (
            "/v1/warp",
            Some(
                json!({"reference": [[0, 0], [4, 0], [4, 4], [0, 4], [2, 2]], "target": [[0, 0], [4, 0], [4, 4], [0, 4], [3, 2]]}),
            ),
        ),
        ("/v1/symmetry", Some(json!({"cohort": "example-cells", "kind": "object", "permutations": 19}))),
        ("/v1/symmetry", Some(json!({"shape": {"points": [[2, 0], [0, 1], [-2, 0], [0, -1]]}, "count": 32}))),
        ("/v1/dictionaries/cells/assess", Some(cells(&["cell0004", "cell0010"]))),
        ("/v1/dictionaries/cells/reconstruct", Some(cells(&["cell0004"]))),
        (
            "/v1/dictionaries/cells/reconstruct",
            Some(json!({"codes": [{"indices": [0, 1], "values": [0.1, -0.1]}]})),
        ),
        ("/v1/dictionaries/cells/drift", None),
        ("/v1/cohorts/example-cells/search", Some(json!({"ids": ["cell0004", "cell0010"], "neighbours": 4}))),
    ]
}

fn cells(ids: &[&str]) -> Value {
    json!({"cohort": "example-cells", "ids": ids})
}

fn ask(server: &Server, path: &str, query: &str, body: Option<&Value>) -> Reply {
    let path = format!("{path}{}{query}", if path.contains('?') { '&' } else { '?' });
    match body {
        Some(body) => server.send(server.request(Method::POST, &path).header("prefer", "wait=50").json(body)),
        None => server.get(&path),
    }
}

/// Checks that every element ends where its parent does.
fn assert_nested(svg: &str) {
    let mut open = Vec::new();
    for tag in svg.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').expect("a tag ends");
        let name = tag.split([' ', '/']).find(|name| !name.is_empty()).unwrap_or_default();
        match (tag.starts_with('/'), tag.ends_with('/')) {
            (true, _) => assert_eq!(open.pop(), Some(name), "{tag}"),
            (false, true) => {}
            (false, false) => open.push(name),
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
    }
    assert!(open.is_empty(), "{open:?}");
}

#[test]
fn every_drawing_obeys_the_settings_of_its_viewer() {
    let server = server();
    let settings = "format=svg&theme=dark&background=none&width=200&title=false&scale_bar=false";
    for (path, body) in drawn() {
        let usual = ask(&server, path, "format=svg", body.as_ref());
        let usual = usual.expect_svg();
        assert_nested(usual);
        assert!(usual.contains("prefers-color-scheme:dark") && usual.contains("<rect y=\"-28\""), "{path}");
        assert!(usual.contains(" width=\"640\""), "{path}");
        let bare = ask(&server, path, settings, body.as_ref());
        let bare = bare.expect_svg();
        assert_nested(bare);
        assert!(
            !bare.contains("<style") && bare.contains(" width=\"200\"") && bare.contains("<title>"),
            "{path}"
        );
        assert!(
            !bare.contains("height=\"100%\"") && bare.contains("#e8e8e8"),
            "{path}: no page, light lines"
        );
        assert!(bare.len() < usual.len(), "{path}: {} of {}", bare.len(), usual.len());
    }
}

#[test]
fn a_legend_is_left_out_with_its_place() {
    let server = server();
    let path = format!("{CELLS}/mean?transformation=similarity&format=svg&title=false");
    let height = |svg: &str| {
        svg.split(" height=\"").nth(1).unwrap().split('"').next().unwrap().parse::<u32>().unwrap()
    };
    let (with, without) = (server.get(&path), server.get(&format!("{path}&legend=false")));
    let (with, without) = (with.expect_svg(), without.expect_svg());
    assert!(with.contains(">120 shapes<") && with.contains(">mean<"));
    assert!(!without.contains("<text"), "{without}");
    assert_eq!(height(with) - height(without), 24);
}

#[test]
fn settings_are_refused_where_they_mean_nothing() {
    let server = server();
    for (path, body) in drawn() {
        for (query, says) in [
            ("format=svg&theme=blue", "theme"),
            ("format=svg&background=white", "background"),
            ("format=svg&width=15", "between 16 and 4096"),
            ("format=svg&width=4097", "between 16 and 4096"),
            ("format=svg&width=wide", "width"),
            ("format=svg&title=no", "title"),
            ("format=svg&scale_bar=1", "scale_bar"),
            ("format=svg&legend=0", "legend"),
            ("format=svg&theme=dark&theme=light", "twice"),
            ("format=svg&colour=red", "colour"),
            ("theme=dark", "only with the formats svg and png"),
            ("format=json&scale_bar=false", "only with the formats svg and png"),
            ("format=json&legend=false", "only with the formats svg and png"),
        ] {
            let reply = ask(&server, path, query, body.as_ref());
            let detail = reply.expect_problem(400, "invalid-query", &[])["detail"].to_string();
            assert!(detail.contains(says), "{path} {query}: {detail}");
        }
    }
    server.get("/v1/cohorts?theme=dark").expect_problem(400, "invalid-query", &[]);
    let pictures = server.request(Method::GET, &format!("{CELLS}/mean?transformation=similarity&width=99"));
    server.send(pictures.header(ACCEPT, "image/svg+xml")).expect_svg();
}

/// Width and height of a PNG file.
fn size_of_png(reply: &Reply) -> [u32; 2] {
    assert_eq!(reply.status, 200, "{}", String::from_utf8_lossy(&reply.body));
    assert_eq!(reply.header("content-type"), Some("image/png"));
    assert_eq!(reply.body[..8], *b"\x89PNG\r\n\x1a\n");
    assert_eq!(reply.body[12..16], *b"IHDR");
    [16, 20].map(|at| u32::from_be_bytes(reply.body[at..at + 4].try_into().unwrap()))
}

#[test]
fn every_drawing_is_also_a_png() {
    let server = server();
    for (path, body) in drawn() {
        let png = |query: &str| ask(&server, path, query, body.as_ref());
        let small = png("format=png&width=160");
        let still =
            if path == "/v1/morph" { "format=svg&width=160&animate=false" } else { "format=svg&width=160" };
        let svg = ask(&server, path, still, body.as_ref());
        let [width, height] = size_of_png(&small);
        let stated = svg.expect_svg().contains(&format!(" width=\"{width}\" height=\"{height}\""));
        assert!(width == 160 && stated, "{path}: {width} × {height}");
        assert_eq!(small.body, png("format=png&width=160").body, "{path}");
        assert_ne!(small.body, png("format=png&width=160&theme=dark").body, "{path}");
        assert_eq!(small.body, png("format=png&width=160&theme=light").body, "{path}");
    }
    let accept = |accept: &str| {
        let path = format!("{CELLS}/mean?transformation=similarity&width=99");
        server.send(server.request(Method::GET, &path).header(ACCEPT, accept))
    };
    assert_eq!(size_of_png(&accept("image/svg+xml;q=0.5, image/png"))[0], 99);
    accept("image/*").expect_svg();
    accept("image/webp").expect_problem(406, "not-acceptable", &[]);
}

#[test]
fn the_mean_of_the_example_is_light() {
    let server = Setting::fresh().with_example().start();
    let path = format!("{CELLS}/mean?transformation=similarity&format=svg");
    let reply = server.get(&path);
    assert!(reply.expect_svg().len() <= 200_000, "{} bytes", reply.text().len());
    assert!(reply.text().contains(">120 shapes<"), "the legend counts");
    let small = server.get(&format!("{path}&width=160"));
    assert!(small.expect_svg().len() <= 120_000, "{} bytes", small.text().len());
    assert_ne!(reply.header("etag"), small.header("etag"));
}

#[test]
fn drawings_of_shapes_with_their_sizes_have_a_scale_bar() {
    let server = server();
    let shape = server.get("/v1/cohorts/marks/shapes/l1?format=svg");
    assert!(shape.expect_svg().contains(" mm</text>"), "{}", shape.text());
    let without = server.get("/v1/cohorts/marks/shapes/l1?format=svg&scale_bar=false");
    assert!(!without.expect_svg().contains(" mm</text>"));
    for (query, has_bar) in [
        ("transformation=rigid&alignment=procrustes", true),
        ("transformation=translation", true),
        ("transformation=similarity", false),
    ] {
        let mean = server.get(&format!("/v1/cohorts/marks/mean?{query}&format=svg"));
        assert_eq!(mean.expect_svg().contains(" mm</text>"), has_bar, "{query}");
    }
}

/// Places at which the lines of a drawing with this colour begin, and the height of the page.
fn starts(svg: &str, colour: &str) -> (Vec<[f64; 2]>, f64) {
    let group = svg.split("<g").filter(|group| group.contains(&format!("stroke=\"{colour}\"")));
    let paths = group.flat_map(|group| group.split(" d=\"M").skip(1));
    let start = |path: &str| {
        let text: String = path.split(['l', '"']).next().unwrap().replace('-', " -");
        let numbers: Vec<f64> = text.split_whitespace().map(|number| number.parse().unwrap()).collect();
        [numbers[0], numbers[1]]
    };
    let view = svg.split("viewBox=\"").nth(1).unwrap().split('"').next().unwrap();
    (paths.map(start).collect(), view.split(' ').nth(3).unwrap().parse().unwrap())
}

#[test]
fn a_cohort_is_drawn_in_one_orientation_whatever_the_frame() {
    let server = server();
    let mean = |query: &str| {
        let path = format!("{CELLS}/mean?transformation=similarity&format=svg&{query}");
        starts(server.get(&path).expect_svg(), "#1b1b1b")
    };
    let (training, height) = mean("frame=training");
    let (canonical, other) = mean("frame=canonical");
    assert_eq!(height, other);
    let near = |a: &[[f64; 2]], b: &[[f64; 2]], reach: f64| {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]) < reach)
    };
    assert!(near(&training, &canonical, 0.5), "{training:?} {canonical:?}");
    // A shape is higher than wide: it fills the height of the room for it.
    assert!(height > 600.0, "{height}");
    // The numbers keep their frames.
    let numbers = |frame: &str| {
        server.get(&format!("{CELLS}/mean?transformation=similarity&frame={frame}")).expect(200)
    };
    assert_ne!(numbers("training")["mean"]["control_points"], numbers("canonical")["mean"]["control_points"]);
    // Under classes without rotations, the orientation of the data means something.
    let (given, _) = mean("alignment=procrustes&frame=training");
    let moved = server.get(&format!("{CELLS}/mean?transformation=translation&format=svg"));
    assert!(!near(&given, &starts(moved.expect_svg(), "#1b1b1b").0, 5.0));
}

#[test]
fn sheets_show_many_shapes_in_little_space() {
    let server = server();
    let path = "/v1/cohorts/example-cells/sheet";
    let sheet = server.get(&format!("{path}?limit=120"));
    let svg = sheet.expect_svg();
    assert_nested(svg);
    assert!(svg.len() <= 600 * 120, "{} bytes a shape", svg.len() / 120);
    assert_eq!(svg.matches("<path").count(), 120);
    assert!(svg.contains("<title>cell0004</title>") && svg.contains(" width=\"960\""));
    assert!(sheet.header("link").is_none() && svg.contains("prefers-color-scheme"));
    // Page by page.
    let first = server.get(&format!("{path}?limit=70&columns=7&size=50"));
    assert!(first.expect_svg().contains(" width=\"350\""));
    let link = first.header("link").unwrap().to_owned();
    let next = link.strip_prefix('<').and_then(|link| link.strip_suffix(">; rel=\"next\"")).unwrap();
    let second = server.get(next);
    assert_eq!(second.expect_svg().matches("<path").count(), 50);
    assert!(second.header("link").is_none());
    // A filter, and a version that is known.
    let some = server.get(&format!("{path}?labels.cell_line=dlm8&limit=3"));
    assert_eq!(some.expect_svg().matches("<path").count(), 3);
    let again = server.request(Method::GET, &format!("{path}?labels.cell_line=dlm8&limit=3"));
    let again = server.send(again.header("if-none-match", some.header("etag").unwrap()));
    assert_eq!(again.status, 304);
    // Landmarks, and PNG.
    let marks = server.get("/v1/cohorts/marks/sheet?columns=4&size=40&format=png");
    assert_eq!(size_of_png(&marks)[0], 160);
    let accept = server.request(Method::GET, "/v1/cohorts/marks/sheet").header(ACCEPT, "image/png");
    assert_eq!(size_of_png(&server.send(accept))[0], 960);
}

#[test]
fn a_scatter_shows_groups_of_scores_with_the_shapes_at_the_ends() {
    let server = server();
    let path = "/v1/dictionaries/cells/scatter";
    let svg = server.get(path).expect_svg().to_owned();
    for text in ["component 1 (", "component 2 (", "example-cells (", "2 standard deviations"] {
        assert!(svg.contains(text), "{text}");
    }
    let groups = server.get(&format!("{path}?x=2&y=3&groups=labels.cell_line&outline=hull&shapes=false"));
    let svg = groups.expect_svg();
    for text in ["component 2 (", "component 3 (", "dlm8 (", "dunn ("] {
        assert!(svg.contains(text), "{text}");
    }
    assert!(!svg.contains("standard deviations"));
    let one = server.get(&format!("{path}?groups=labels.cell_line&labels.cell_line=dlm8&format=png"));
    assert_eq!(size_of_png(&one)[0], 640);
    for (query, says) in [
        ("x=0", "between 1 and 4"),
        ("y=5", "between 1 and 4"),
        ("x=2&y=2", "another component than x"),
        ("groups=shoe", "got 'shoe'"),
        ("groups=external_id", "at most 24 values"),
        ("outline=star", "outline"),
        ("shapes=maybe", "true or false"),
        ("labels.shoe=9", "labels.shoe"),
        ("colour=red", "colour"),
        ("format=json", "'svg' or 'png'"),
        ("cohort=marks", "cohort: expected a cohort with the representation"),
    ] {
        let reply = server.get(&format!("{path}?{query}"));
        let detail = reply.expect_problem(400, "invalid-query", &[])["detail"].to_string();
        assert!(detail.contains(says), "{query}: {detail}");
    }
    server.get("/v1/dictionaries/nothing/scatter").expect_problem(404, "not-found", &[]);
    server.get(&format!("{path}?cohort=nothing")).expect_problem(404, "not-found", &[]);
}

#[test]
fn sheets_refuse_what_they_cannot_show() {
    let server = server();
    for (query, says) in [
        ("columns=0", "columns"),
        ("columns=101", "between 1 and 100"),
        ("size=15", "size"),
        ("size=401", "between 16 and 400"),
        ("size=x", "got 'x'"),
        ("columns=100&size=41", "at most 4096"),
        ("columns=1&size=400&limit=1000&format=png", "at most 20000000 pixels"),
        ("width=300", "follows from columns and size"),
        ("format=json", "'svg' or 'png'"),
        ("limit=1001", "limit"),
        ("theme=blue", "theme"),
        ("colour=red", "colour"),
        ("cursor=here", "cursor"),
        ("labels.shoe=9", "labels.shoe"),
    ] {
        let reply = server.get(&format!("/v1/cohorts/example-cells/sheet?{query}"));
        let detail = reply.expect_problem(400, "invalid-query", &[])["detail"].to_string();
        assert!(detail.contains(says), "{query}: {detail}");
    }
    server.get("/v1/cohorts/nothing/sheet").expect_problem(404, "not-found", &[]);
    let json = server.request(Method::GET, "/v1/cohorts/marks/sheet").header(ACCEPT, "application/json");
    server.send(json).expect_problem(406, "not-acceptable", &[]);
}

#[test]
fn paths_are_drawn_as_strips_where_nothing_moves() {
    let server = Setting::fresh().start();
    let curve = json!({"kind": "closed_curve", "dimension": 2, "control_points": 4,
        "generator": {"name": "trigonometric"}});
    let ring = |a: f64, b: f64| json!({"points": [[a, 0.0], [0.0, b], [-a, 0.5], [0.0, -b]]});
    let body = json!({"representation": curve, "from": ring(2.0, 1.0), "to": ring(1.0, 3.0), "steps": 31});
    let moving = server.post("/v1/morph?format=svg", &body);
    assert!(moving.expect_svg().contains("<animate") && moving.text().contains(">first shape<"));
    let strip = server.post("/v1/morph?format=svg&animate=false", &body);
    assert!(!strip.expect_svg().contains("<animate") && strip.text().contains(">second shape<"));
    assert_eq!(strip.text().matches("<path").count(), 7);
    size_of_png(&server.post("/v1/morph?format=png&animate=false", &body));
    for query in
        ["format=png&animate=true", "animate=false", "format=svg&animate=maybe", "format=svg&anim=true"]
    {
        server.post(&format!("/v1/morph?{query}"), &body).expect_problem(400, "invalid-query", &[]);
    }
}

#[test]
fn captions_are_words() {
    let server = server();
    let picture =
        |path: &str, body: &Value| ask(&server, path, "format=svg", Some(body)).expect_svg().to_owned();
    let groups = json!({"cohort": "example-cells", "by": "labels.treatment", "permutations": 99});
    let groups = picture("/v1/comparisons", &groups);
    assert!(groups.contains("strongest colour: where most") && groups.contains("distance from control to"));
    let size = json!({"cohort": "example-cells", "attribute": "log_centroid_size", "permutations": 19});
    let size = picture("/v1/regressions", &size);
    assert!(size.contains("centroid size explains") && size.contains("5 % quantile"), "{size}");
    let modes = server.get("/v1/dictionaries/cells/modes?format=svg");
    assert!(modes.expect_svg().contains("σ is the standard deviation"));
    let assessed = picture("/v1/dictionaries/cells/assess", &cells(&["cell0004"]));
    assert!(
        assessed.contains("usual<") && assessed.contains("coloured by the distance to its reconstruction")
    );
    let nearest = json!({"ids": ["cell0004"], "neighbours": 3});
    let nearest = picture("/v1/cohorts/example-cells/search", &nearest);
    assert!(nearest.contains(">cell0004<") && nearest.matches("<path").count() == 7, "{nearest}");
    // Drift: nothing new at first, then some cells once more.
    let drift = || server.get("/v1/dictionaries/cells/drift?format=svg").expect_svg().to_owned();
    assert!(drift().contains("no shapes were added since revision"));
    let cell = server.get(&format!("{CELLS}/shapes/cell0004")).expect(200);
    let points = cell["control_points"].as_array().unwrap();
    let again = |k: usize| {
        let moved: Vec<Value> = points
            .iter()
            .enumerate()
            .map(|(i, p)| json!([p[0].as_f64().unwrap() + ((i * k) % 5) as f64, p[1].as_f64().unwrap()]))
            .collect();
        json!({"external_id": format!("new{k}"), "points": moved})
    };
    let shapes: Vec<Value> = (1..4).map(again).collect();
    server.post(&format!("{CELLS}/shapes"), &json!({"shapes": shapes})).expect(201);
    let drift = drift();
    assert!(drift.contains("of the 3 shapes added since revision"), "{drift}");
    assert!(drift.contains("a line for each component") && drift.contains(">1<"), "{drift}");
}
