//! Bearer tokens of an identity provider, which is a small server of this test.

use std::sync::{Arc, Mutex};

use axum::Router;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use jsonwebtoken::jwk::Jwk;
use jsonwebtoken::{Algorithm, EncodingKey, Header, encode};
use rcgen::{KeyPair, RsaKeySize};
use reqwest::Method;
use serde_json::{Value, json};

use crate::server::{Reply, Server, Setting, wait};

const AUDIENCE: &str = "shapelex";

/// What the provider answers.
#[derive(Default)]
struct Answers {
    issuer: String,
    keys: Vec<Value>,
    away: bool,
}

/// An identity provider.
#[derive(Clone)]
struct Provider(Arc<Mutex<Answers>>);

impl Provider {
    fn start() -> Self {
        let listener = wait(tokio::net::TcpListener::bind("127.0.0.1:0")).unwrap();
        let issuer = format!("http://{}", listener.local_addr().unwrap());
        let provider = Self(Arc::new(Mutex::new(Answers { issuer, ..Answers::default() })));
        let routes = Router::new()
            .route("/.well-known/openid-configuration", get(discovery))
            .route("/jwks", get(jwks))
            .with_state(provider.clone());
        wait(async { drop(tokio::spawn(async move { axum::serve(listener, routes).await.unwrap() })) });
        provider
    }

    fn issuer(&self) -> String {
        self.0.lock().unwrap().issuer.clone()
    }

    fn set_keys(&self, keys: &[&Signer]) {
        self.0.lock().unwrap().keys = keys.iter().map(|key| key.public.clone()).collect();
    }

    fn set_away(&self, away: bool) {
        self.0.lock().unwrap().away = away;
    }

    fn answer(&self, content: impl Fn(&Answers) -> Value) -> Response {
        let answers = self.0.lock().unwrap();
        if answers.away {
            return StatusCode::SERVICE_UNAVAILABLE.into_response();
        }
        axum::Json(content(&answers)).into_response()
    }

    /// The service that trusts it.
    fn service(&self, flags: &[&str]) -> Server {
        let setting = Setting::fresh().flags(&["--oidc-issuer", &self.issuer(), "--oidc-audience", AUDIENCE]);
        setting.flags(flags).start()
    }

    /// Claims that open the service.
    fn claims(&self) -> Value {
        json!({"iss": self.issuer(), "aud": AUDIENCE, "sub": "alice", "exp": now() + 600, "roles": ["writer"]})
    }
}

async fn discovery(State(provider): State<Provider>) -> Response {
    provider
        .answer(|answers| json!({"issuer": answers.issuer, "jwks_uri": format!("{}/jwks", answers.issuer)}))
}

async fn jwks(State(provider): State<Provider>) -> Response {
    provider.answer(|answers| json!({"keys": answers.keys}))
}

fn now() -> u64 {
    jsonwebtoken::get_current_timestamp()
}

/// A key of the provider.
struct Signer {
    id: String,
    algorithm: Algorithm,
    private: EncodingKey,
    public: Value,
    public_pem: String,
}

impl Signer {
    fn new(id: &str, algorithm: Algorithm) -> Self {
        let pair = match algorithm {
            Algorithm::ES256 => KeyPair::generate_for(&rcgen::PKCS_ECDSA_P256_SHA256),
            Algorithm::ES384 => KeyPair::generate_for(&rcgen::PKCS_ECDSA_P384_SHA384),
            Algorithm::EdDSA => KeyPair::generate_for(&rcgen::PKCS_ED25519),
            _ => KeyPair::generate_rsa_for(&rcgen::PKCS_RSA_SHA256, RsaKeySize::_2048),
        };
        let pair = pair.unwrap();
        let der = pair.serialize_der();
        let private = match algorithm {
            Algorithm::ES256 | Algorithm::ES384 => EncodingKey::from_ec_der(&der),
            Algorithm::EdDSA => EncodingKey::from_ed_der(&der),
            _ => EncodingKey::from_rsa_pem(pair.serialize_pem().as_bytes()).unwrap(),
        };
        let mut public = match algorithm {
            Algorithm::EdDSA => json!({"kty": "OKP", "crv": "Ed25519", "x": base64(pair.public_key_raw())}),
            _ => serde_json::to_value(Jwk::from_encoding_key(&private, algorithm).unwrap()).unwrap(),
        };
        public["kid"] = id.into();
        public["use"] = "sig".into();
        Self { id: id.into(), algorithm, private, public, public_pem: pair.public_key_pem() }
    }

    /// A token with these claims.
    fn sign(&self, claims: &Value) -> String {
        let header = Header { kid: Some(self.id.clone()), ..Header::new(self.algorithm) };
        encode(&header, claims, &self.private).unwrap()
    }
}

/// Base64 of the alphabet for URLs, without padding.
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";
    let digits = |group: &[u8]| {
        let bits =
            group.iter().fold(0_u32, |bits, byte| bits << 8 | u32::from(*byte)) << (8 * (3 - group.len()));
        let digit = move |i: usize| char::from(ALPHABET[(bits >> (18 - 6 * i)) as usize & 63]);
        (0..=group.len()).map(digit).collect::<String>()
    };
    bytes.chunks(3).map(digits).collect()
}

fn get_with(server: &Server, path: &str, token: &str) -> Reply {
    server.send(server.request(Method::GET, path).bearer_auth(token))
}

/// The same claims with one changed; null takes it away.
fn with(claims: &Value, name: &str, value: Value) -> Value {
    let mut claims = claims.clone();
    match value {
        Value::Null => claims.as_object_mut().unwrap().remove(name),
        value => claims.as_object_mut().unwrap().insert(name.into(), value),
    };
    claims
}

/// Asserts that a token is refused with the one sentence, and that the log, and only it, says why.
#[track_caller]
fn assert_refused(server: &Server, token: &str, check: &str) {
    let reply = get_with(server, "/v1/cohorts", token);
    let problem = reply.expect_problem(401, "unauthenticated", &[]);
    assert_eq!(
        problem["detail"],
        "authentication required: send a valid key or token in the header 'Authorization: Bearer …'"
    );
    assert_eq!(reply.header("www-authenticate"), Some("Bearer"));
    let log = server.log();
    let last = log.lines().rfind(|line| line.contains("a credential was refused")).unwrap_or_default();
    assert!(last.contains(check), "'{check}' is not in {last}");
    assert!(token.len() < 9 || !log.contains(token), "the token is in the log");
}

#[test]
fn good_tokens_of_every_algorithm_open_the_service() {
    let provider = Provider::start();
    let algorithms = [
        Algorithm::RS256,
        Algorithm::RS384,
        Algorithm::RS512,
        Algorithm::ES256,
        Algorithm::ES384,
        Algorithm::EdDSA,
    ];
    let signers: Vec<Signer> = algorithms
        .iter()
        .enumerate()
        .map(|(i, algorithm)| Signer::new(&format!("key-{i}"), *algorithm))
        .collect();
    provider.set_keys(&signers.iter().collect::<Vec<_>>());
    let server = provider.service(&[]);
    // With an identity provider nobody is let in without a token, although the address is a loopback one.
    assert_eq!(server.get("/v1/cohorts").status, 401);
    assert_eq!(server.get("/livez").status, 204);
    for signer in &signers {
        let token = signer.sign(&provider.claims());
        assert_eq!(get_with(&server, "/v1/cohorts", &token).status, 200, "{:?}", signer.algorithm);
    }
    let several = with(&provider.claims(), "aud", json!(["other", AUDIENCE]));
    assert_eq!(get_with(&server, "/v1/cohorts", &signers[0].sign(&several)).status, 200);
    // The roles of tokens are those of keys.
    let token = signers[3].sign(&provider.claims());
    let reply = get_with(&server, "/v1/keys", &token);
    let problem = reply.expect_problem(403, "forbidden", &[]);
    assert_eq!(problem["detail"], "expected the role admin, the caller has the role writer");
    let admin = signers[3].sign(&with(&provider.claims(), "roles", json!("reader admin")));
    assert_eq!(get_with(&server, "/v1/keys", &admin).status, 200);
}

#[test]
fn the_page_learns_of_the_provider_and_may_call_it_and_nothing_else() {
    let provider = Provider::start();
    let issuer = provider.issuer();
    let server = provider.service(&["--oidc-client-id", "page", "--oidc-scope", "openid shapes"]);
    let reply = server.get("/app/login.json");
    assert_eq!(reply.header("cache-control"), Some("no-store"));
    let wanted = json!({"provider": {"issuer": issuer, "client_id": "page", "scope": "openid shapes"}});
    assert_eq!(reply.expect(200), wanted);
    let page = server.get("/app/cohorts");
    let policy = page.header("content-security-policy").unwrap();
    assert!(policy.split("; ").any(|part| part == format!("connect-src 'self' {issuer}")), "{policy}");
    assert_eq!(policy.matches("http").count(), 1, "{policy}");
    // Data and the reference may not call it.
    for path in ["/v1/cohorts", "/docs/"] {
        let reply = server.get(path);
        assert!(!reply.header("content-security-policy").unwrap().contains(&issuer), "{path}");
    }
    // Programs alone use the tokens of this one.
    let server = provider.service(&[]);
    assert_eq!(server.get("/app/login.json").expect(200), json!({"provider": null}));
    let page = server.get("/");
    assert!(page.header("content-security-policy").unwrap().contains("connect-src 'self';"));
}

#[test]
fn bad_tokens_are_refused_and_only_the_log_says_why() {
    let provider = Provider::start();
    let (signer, stranger) = (Signer::new("a", Algorithm::RS256), Signer::new("a", Algorithm::RS256));
    let curve = Signer::new("c", Algorithm::ES256);
    provider.set_keys(&[&signer, &curve]);
    let server = provider.service(&["--oidc-leeway-seconds", "5"]);
    let claims = provider.claims();
    let good = signer.sign(&claims);
    assert_eq!(get_with(&server, "/v1/cohorts", &good).status, 200);

    assert_refused(&server, &stranger.sign(&claims), "bad signature");
    let (head, rest) = good.split_once('.').unwrap();
    let (body, signature) = rest.split_once('.').unwrap();
    let forged = base64(with(&claims, "roles", json!("admin")).to_string().as_bytes());
    assert_refused(&server, &format!("{head}.{forged}.{signature}"), "bad signature");
    let none = base64(json!({"alg": "none", "kid": "a"}).to_string().as_bytes());
    assert_refused(&server, &format!("{none}.{body}."), "not the form of a token");
    assert_refused(&server, &format!("{none}.{body}.{signature}"), "not the form of a token");
    // The public key as a shared secret: who knows it could else sign whatever it likes.
    for secret in [signer.public_pem.as_bytes(), signer.public["n"].as_str().unwrap().as_bytes()] {
        let header = Header { kid: Some("a".into()), ..Header::new(Algorithm::HS256) };
        let token = encode(&header, &claims, &EncodingKey::from_secret(secret)).unwrap();
        assert_refused(&server, &token, "algorithm of a token that is not accepted");
    }
    let other = Header { kid: Some("a".into()), ..Header::new(Algorithm::RS512) };
    let token = encode(&other, &claims, &signer.private).unwrap();
    assert_refused(&server, &token, "another algorithm");
    let other = Header { kid: Some("c".into()), ..Header::new(Algorithm::RS256) };
    assert_refused(&server, &encode(&other, &claims, &signer.private).unwrap(), "another algorithm");
    let unknown = Signer { id: "b".into(), ..Signer::new("b", Algorithm::RS256) };
    assert_refused(&server, &unknown.sign(&claims), "unknown key id");
    let nameless = encode(&Header::new(Algorithm::RS256), &claims, &signer.private).unwrap();
    assert_refused(&server, &nameless, "without key id");
    let critical =
        Header { kid: Some("a".into()), crit: Some(vec!["b64".into()]), ..Header::new(Algorithm::RS256) };
    assert_refused(&server, &encode(&critical, &claims, &signer.private).unwrap(), "conditions");
    let changes = [
        ("exp", json!(now() - 60), "expired token"),
        ("exp", Value::Null, "without exp"),
        ("exp", json!("soon"), "token"),
        ("nbf", json!(now() + 60), "not valid yet"),
        ("aud", json!("another service"), "wrong audience"),
        ("aud", Value::Null, "without exp, iss, aud or sub"),
        ("iss", json!("https://evil.example"), "wrong issuer"),
        ("iss", Value::Null, "without exp, iss, aud or sub"),
        ("iss", json!([provider.issuer()]), "wrong issuer"),
        ("sub", Value::Null, "without exp, iss, aud or sub"),
        ("sub", json!(""), "without exp, iss, aud or sub"),
        ("sub", json!(" "), "without exp, iss, aud or sub"),
    ];
    for (name, value, check) in changes {
        assert_refused(&server, &signer.sign(&with(&claims, name, value)), check);
    }
    assert_refused(&server, "a.b.c", "not the form of a token");
    assert_refused(&server, "shk_0_0", "not the form of a key");
    for roles in [Value::Null, json!([]), json!(["root"]), json!(7)] {
        let reply = get_with(&server, "/v1/cohorts", &signer.sign(&with(&claims, "roles", roles)));
        reply.expect_problem(403, "forbidden", &[]);
    }
    // Clocks differ by a little.
    let late = with(&with(&claims, "exp", json!(now() - 1)), "nbf", json!(now() + 2));
    assert_eq!(get_with(&server, "/v1/cohorts", &signer.sign(&late)).status, 200);
}

#[test]
fn groups_of_the_provider_stand_for_roles() {
    let provider = Provider::start();
    let signer = Signer::new("a", Algorithm::ES256);
    provider.set_keys(&[&signer]);
    let map = "/radiology/Writer=writer; CN=Admins,OU=Clinic=admin";
    let flags = ["--oidc-role-claim", "groups", "--oidc-role-map", map, "--oidc-tenant-claim", "clinic"];
    let server = provider.service(&flags);
    let status = |groups: Value, path: &str| {
        let claims = with(&with(&provider.claims(), "groups", groups), "clinic", json!("radiology"));
        get_with(&server, path, &signer.sign(&claims)).status
    };
    assert_eq!(status(json!(["/radiology/Writer"]), "/v1/cohorts"), 200);
    assert_eq!(status(json!(["/radiology/Writer"]), "/v1/keys"), 403);
    assert_eq!(status(json!(["/radiology/Writer", "CN=Admins,OU=Clinic"]), "/v1/keys"), 200);
    assert_eq!(status(json!(["/radiology"]), "/v1/cohorts"), 403);
}

#[test]
fn keys_of_the_provider_rotate_and_outlive_its_absence() {
    let provider = Provider::start();
    let (first, second, third) = (
        Signer::new("first", Algorithm::ES256),
        Signer::new("second", Algorithm::ES256),
        Signer::new("third", Algorithm::ES256),
    );
    provider.set_keys(&[&first]);
    let server = provider.service(&[]);
    let status = |signer: &Signer| get_with(&server, "/v1/cohorts", &signer.sign(&provider.claims())).status;
    assert_eq!(status(&first), 200);
    provider.set_keys(&[&first, &second]);
    assert_eq!(status(&second), 200, "an unknown key id is asked for at once");
    provider.set_keys(&[&first, &second, &third]);
    assert_eq!(status(&third), 401, "but not twice in a minute");
    provider.set_away(true);
    assert_eq!([status(&first), status(&second), status(&third)], [200, 200, 401], "the last good set stays");
}

#[test]
fn a_provider_that_never_answered_is_not_the_fault_of_the_client() {
    let provider = Provider::start();
    let signer = Signer::new("a", Algorithm::ES256);
    provider.set_keys(&[&signer]);
    provider.set_away(true);
    let server = provider.service(&[]);
    let token = signer.sign(&provider.claims());
    let reply = get_with(&server, "/v1/cohorts", &token);
    reply.expect_problem(503, "unavailable", &[]);
    assert!(reply.header("retry-after").is_some());
    assert_eq!(server.get("/v1/cohorts").status, 401);
    provider.set_away(false);
    let end = std::time::Instant::now() + std::time::Duration::from_secs(20);
    while get_with(&server, "/v1/cohorts", &token).status != 200 {
        assert!(std::time::Instant::now() < end, "the provider is not asked again: {}", server.log());
        std::thread::sleep(std::time::Duration::from_millis(300));
    }
}

#[test]
fn tokens_name_tenants_and_keys_can_be_set() {
    let provider = Provider::start();
    let signer = Signer::new("a", Algorithm::ES256);
    provider.set_keys(&[&signer]);
    let jwks = format!("{}/jwks", provider.issuer());
    let flags = [
        "--oidc-jwks-url",
        &jwks,
        "--oidc-tenant-claim",
        "org.id",
        "--oidc-role-claim",
        "realm_access.roles",
    ];
    let server = provider.service(&flags);
    let claims = with(&provider.claims(), "realm_access", json!({"roles": ["offline", "admin"]}));
    let of_tenant = |tenant: Value| signer.sign(&with(&claims, "org", json!({"id": tenant})));
    let north = of_tenant("north".into());
    let cohort = json!({"name": "c", "representation": {"kind": "landmarks", "dimension": 2, "points": 3}});
    let create = |token: &str| {
        server.send(server.request(Method::POST, "/v1/cohorts").bearer_auth(token).json(&cohort)).status
    };
    assert_eq!(create(&north), 201);
    assert_eq!(create(&north), 409);
    let south = of_tenant("south".into());
    assert_eq!(get_with(&server, "/v1/cohorts/c", &south).status, 404);
    assert_eq!(create(&south), 201, "the name is free in another tenant");
    // Some providers write an attribute of a person as a list.
    let listed = of_tenant(json!(["north"]));
    assert_eq!((create(&listed), get_with(&server, "/v1/cohorts/c", &listed).status), (409, 200));
    for (tenant, said) in [
        (Value::Null, "names no tenant"),
        (json!(""), "in a form that no tenant has"),
        (json!("a/b"), "in a form that no tenant has"),
        (json!([]), "names no tenant"),
        (json!(["north", "south"]), "names several tenants, expected one"),
    ] {
        let refused = get_with(&server, "/v1/cohorts", &of_tenant(tenant));
        let problem = refused.expect_problem(403, "forbidden", &[]);
        assert!(problem["detail"].as_str().unwrap().contains(said), "{problem}");
    }
}
