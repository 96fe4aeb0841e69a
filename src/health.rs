//! Health check of a running service, for containers without an HTTP client.

use std::net::IpAddr;
use std::time::Duration;

use reqwest::{Client, Url};

/// Longest time to wait for the response.
const PATIENCE: Duration = Duration::from_secs(3);

/// Succeeds if the address returns a success status in time.
///
/// # Errors
/// The actual outcome, in one sentence.
pub(crate) async fn ask(address: &str) -> Result<(), String> {
    let url: Url = address.parse().map_err(|error| format!("expected a URL, got '{address}': {error}"))?;
    let client = Client::builder()
        .no_proxy()
        .redirect(reqwest::redirect::Policy::none())
        .timeout(PATIENCE)
        // The certificate names the public host. On a loopback address no other host can answer, and no secret is sent.
        .tls_danger_accept_invalid_certs(is_loopback(&url))
        .build()
        .map_err(|error| error.to_string())?;
    let answer =
        client.get(url).send().await.map_err(|error| format!("{address} does not answer: {error}"))?;
    let status = answer.status();
    if status.is_success() { Ok(()) } else { Err(format!("{address} answers {status}")) }
}

fn is_loopback(url: &Url) -> bool {
    let host = url.host_str().unwrap_or_default().trim_matches(['[', ']']);
    host == "localhost" || host.parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_own_machine_may_have_any_certificate() {
        let loopback = |address: &str| is_loopback(&address.parse().unwrap());
        for own in
            ["https://localhost:1/readyz", "https://127.0.0.1/", "https://127.9.9.9/", "https://[::1]:8443/"]
        {
            assert!(loopback(own), "{own}");
        }
        for other in [
            "https://10.0.0.1/",
            "https://localhost.example/",
            "https://127.0.0.1.example/",
            "https://[::2]/",
        ] {
            assert!(!loopback(other), "{other}");
        }
    }
}
