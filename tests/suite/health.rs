//! The command with which a container asks whether its service is well.

use std::process::{Command, Output};

use crate::server::Server;

fn ask(address: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_shapelex"));
    // A proxy of the environment is not asked: the question is about this machine.
    command.env("http_proxy", "http://127.0.0.1:1").args(["health", "--url", address]).output().unwrap()
}

#[test]
fn health_is_what_the_service_answers() {
    let server = Server::fresh();
    for (path, healthy) in [("/readyz", true), ("/livez", true), ("/v1/nothing", false)] {
        let output = ask(&format!("{}{path}", server.address()));
        assert_eq!(output.status.success(), healthy, "{path}: {output:?}");
    }
    let address = format!("{}/readyz", server.address());
    drop(server);
    for address in [address.as_str(), "nowhere"] {
        let output = ask(address);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(
            said.starts_with(&format!("shapelex: {address}")) || said.contains("expected a URL"),
            "{said}"
        );
    }
}
