//! Landmarks of salamander heads, beside partial Procrustes fits and tangent projections in numpy and what geomorph 4.0.8 prints of them (Adams 2004,
//! 2010; `data(plethodon)`).

use std::path::Path;

use serde_json::{Value, json};

use crate::server::Server;

/// Where the landmarks are, if they are there: they are not a part of the project.
fn landmarks() -> Option<String> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/landmarks-plethodon/landmarks.csv");
    std::fs::read_to_string(file).ok()
}

fn shape(line: &str) -> Value {
    let fields: Vec<&str> = line.split(',').collect();
    let numbers: Vec<f64> = fields[3..].iter().map(|field| field.parse().unwrap()).collect();
    json!({
        "external_id": fields[0], "label": format!("{} {}", fields[1], fields[2]),
        "labels": {"species": fields[1], "site": fields[2]}, "points": numbers.chunks(2).collect::<Vec<_>>()
    })
}

#[test]
fn partial_procrustes_fits_are_those_of_numpy_and_print_as_those_of_geomorph() {
    let Some(text) = landmarks() else {
        println!("SKIPPED: landmarks-plethodon is not beside the project");
        return;
    };
    let server = Server::fresh();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 12});
    let body = json!({"name": "plethodon", "correspondence": "landmarks", "representation": representation});
    server.post("/v1/cohorts", &body).expect(201);
    let shapes: Vec<Value> = text.lines().skip(1).map(shape).collect();
    server.post("/v1/cohorts/plethodon/shapes", &json!({"shapes": shapes})).expect(201);
    // The first centroid size that geomorph prints is that of the first specimen.
    let first = server.get("/v1/cohorts/plethodon/shapes?limit=1").expect(200);
    assert!(
        (first["items"][0]["measures"]["centroid_size"].as_f64().unwrap() - 15.2269).abs() < 5e-5,
        "{first}"
    );

    let points: Vec<Value> = shapes.iter().map(|shape| json!({"points": shape["points"]})).collect();
    let fractions = |further: Value| {
        let mut body = json!({"representation": representation, "correspondence": "landmarks",
                              "transformation": "similarity", "components": 3, "aligned": false, "shapes": points});
        body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        let pca = server.post("/v1/pca", &body).expect(200);
        assert_eq!(pca["warnings"], json!([]), "{pca}");
        pca["pca"]["explained"].clone()
    };
    // `Proj = FALSE` and `Proj = TRUE` of geomorph in numpy; the closed form of the default differs from the latter by the mean.
    let fits = json!({"alignment": "partial_procrustes"});
    let projected = json!({"alignment": "partial_procrustes", "tangent": true});
    for (further, wanted, within) in [
        (fits, [0.367_441_51, 0.310_163_84, 0.082_011_96], 1e-8),
        (projected, [0.367_433_32, 0.310_233_28, 0.082_005_40], 1e-8),
        (json!({}), [0.367_433_14, 0.310_233_40, 0.082_005_38], 1e-8),
        (json!({}), [0.367_433_32, 0.310_233_28, 0.082_005_40], 1e-6),
    ] {
        let found = fractions(further.clone());
        for (k, wanted) in wanted.into_iter().enumerate() {
            let found = found[k].as_f64().unwrap();
            assert!((found - wanted).abs() < within, "{further}, component {k}: {found} for {wanted}");
        }
    }

    let compared = |by: &str, further: Value| {
        let mut body = json!({"cohort": "plethodon", "by": by, "permutations": 99});
        body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        server.post("/v1/comparisons", &body).expect(200)
    };
    // Beside each value, what geomorph prints.
    let near = |what: &str, found: &Value, [wanted, printed, half_of_the_last_digit]: [f64; 3]| {
        let found = found.as_f64().unwrap();
        assert!((found - wanted).abs() < 1e-8 * wanted, "{what}: {found} for {wanted}");
        assert!(
            (found - printed).abs() < half_of_the_last_digit,
            "{what}: {found}, geomorph prints {printed}"
        );
    };
    let fits = json!({"alignment": "partial_procrustes"});
    let species = compared("labels.species", fits.clone());
    near("F of the species", &species["pairs"][0]["pseudo_f"]["value"], [6.630_398_753_651, 6.630, 5e-4]);
    near("R² of the species", &species["pairs"][0]["r_squared"], [0.148_562_391_079, 0.1486, 5e-5]);
    let groups = compared("label", fits);
    near("F of the four groups", &groups["overall"]["pseudo_f"]["value"], [20.632_015_122_825, 20.63, 5e-3]);

    let mut body = json!({"cohort": "plethodon", "attribute": "log_centroid_size", "permutations": 99});
    let by_default = server.post("/v1/regressions", &body).expect(200);
    body["alignment"] = json!("partial_procrustes");
    let regression = server.post("/v1/regressions", &body).expect(200);
    near("R² of log size", &regression["r_squared"], [0.045_161_234_437, 0.0452, 5e-5]);

    // The closed form of the default reproduces these fits to 1e-6 of the sums of squares, and so what geomorph prints.
    let close = |found: &Value, wanted: f64| {
        let found = found.as_f64().unwrap();
        assert!((found - wanted).abs() < 1e-6 * wanted.max(1.0), "{found} for {wanted}");
    };
    close(&by_default["r_squared"], 0.045_161_234_437);
    let species = compared("labels.species", json!({}));
    assert_eq!((&species["alignment"], &species["tangent"]), (&json!("projection"), &json!(true)));
    close(&species["pairs"][0]["r_squared"], 0.148_562_391_079);
    close(&species["pairs"][0]["pseudo_f"]["value"], 6.630_401_475_616);
    close(&compared("label", json!({}))["overall"]["r_squared"], 0.632_262_979_935);
}
