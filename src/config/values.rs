//! Values of settings as they are written: addresses with names, sizes with units.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, ToSocketAddrs as _};
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::str::FromStr;

use serde::de::{Deserialize, Deserializer, Error, Visitor};

use super::LogFormat;

/// Text or number given for a setting, and the value that it stands for.
pub trait Given {
    /// The value.
    type Value;

    /// The value that was given.
    fn value(self) -> Self::Value;
}

macro_rules! plain {
    ($($type:ty),*) => {
        $(impl Given for $type {
            type Value = Self;

            fn value(self) -> Self {
                self
            }
        })*
    };
}
plain!(bool, u32, u64, usize, NonZeroUsize, String, PathBuf, LogFormat);

/// Number of bytes: `67108864`, `64MiB` or `64MB`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bytes(pub usize);

/// Units, in lower case.
const UNITS: [(&str, usize); 8] = [
    ("", 1),
    ("b", 1),
    ("kb", 1000),
    ("mb", 1_000_000),
    ("gb", 1_000_000_000),
    ("kib", 1 << 10),
    ("mib", 1 << 20),
    ("gib", 1 << 30),
];

impl Given for Bytes {
    type Value = usize;

    fn value(self) -> usize {
        self.0
    }
}

impl FromStr for Bytes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
        let unit = text[end..].trim_start().to_ascii_lowercase();
        let size = UNITS.iter().find(|(name, _)| *name == unit).map(|(_, size)| size);
        let number: Option<usize> = text[..end].parse().ok();
        number.zip(size).and_then(|(number, size)| number.checked_mul(*size)).map(Self).ok_or_else(|| {
            format!("expected a number of bytes, such as 67108864, 64MiB or 64MB, got '{text}'")
        })
    }
}

impl<'de> Deserialize<'de> for Bytes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Size)
    }
}

/// Reads a number, or a text with a unit.
struct Size;

impl Visitor<'_> for Size {
    type Value = Bytes;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number of bytes, such as 67108864 or \"64MiB\"")
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<Bytes, E> {
        usize::try_from(number)
            .map(Bytes)
            .map_err(|_| E::custom(format!("expected a number of bytes, got {number}")))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Bytes, E> {
        text.parse().map_err(E::custom)
    }
}

/// Address to listen on: a number or name of a host, or none for all networks, and a port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ListenAddress(SocketAddr);

impl Given for ListenAddress {
    type Value = SocketAddr;

    fn value(self) -> SocketAddr {
        self.0
    }
}

impl FromStr for ListenAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Ok(address) = text.parse() {
            return Ok(Self(address));
        }
        let expected =
            || format!("expected an address such as 127.0.0.1:8080, localhost:8080 or :8080, got '{text}'");
        let (host, port) = text.rsplit_once(':').ok_or_else(expected)?;
        let port: u16 = port.parse().map_err(|_| expected())?;
        if host.is_empty() {
            return Ok(Self((Ipv4Addr::UNSPECIFIED, port).into()));
        }
        if host.contains([':', '/', ' ']) {
            return Err(expected());
        }
        let unknown = |error| format!("expected an address of this machine, got '{text}': {error}");
        let found: Vec<SocketAddr> = (host, port).to_socket_addrs().map_err(unknown)?.collect();
        // `localhost` is both; clients that know one of them know that of version 4.
        let first = found.iter().find(|address| matches!(address.ip(), IpAddr::V4(_))).or(found.first());
        first.copied().map(Self).ok_or_else(expected)
    }
}

impl<'de> Deserialize<'de> for ListenAddress {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_may_have_units() {
        let read = |text: &str| text.parse::<Bytes>().map(Given::value);
        for (text, wanted) in [
            ("0", 0),
            ("67108864", 64 << 20),
            ("64MiB", 64 << 20),
            ("64 MB", 64_000_000),
            ("2gib", 2 << 30),
            ("3kB", 3000),
            ("5B", 5),
        ] {
            assert_eq!(read(text), Ok(wanted), "{text}");
        }
        for wrong in ["", "MB", "-1", "1.5GB", "64M", "64 parsecs", "99999999999999999999", "99999999999GiB"]
        {
            assert!(read(wrong).unwrap_err().contains(&format!("64MiB or 64MB, got '{wrong}'")), "{wrong}");
        }
    }

    #[test]
    fn sizes_of_files_are_numbers_or_texts() {
        #[derive(Debug, serde::Deserialize)]
        struct File {
            size: Bytes,
        }
        let read = |text: &str| toml::from_str::<File>(text).map(|file| file.size.value());
        assert_eq!((read("size = 7").unwrap(), read("size = \"1 kB\"").unwrap()), (7, 1000));
        for wrong in ["size = -1", "size = \"1 pound\"", "size = true"] {
            assert!(read(wrong).unwrap_err().to_string().contains("a number of bytes"), "{wrong}");
        }
    }

    #[test]
    fn addresses_may_have_names_or_none() {
        let read = |text: &str| text.parse::<ListenAddress>().map(|address| address.value().to_string());
        for (text, wanted) in [
            ("127.0.0.1:8080", "127.0.0.1:8080"),
            ("[::1]:1", "[::1]:1"),
            ("localhost:8080", "127.0.0.1:8080"),
            (":8080", "0.0.0.0:8080"),
            (":0", "0.0.0.0:0"),
        ] {
            assert_eq!(read(text).as_deref(), Ok(wanted), "{text}");
        }
        for wrong in
            ["8080", "localhost", "localhost:", ":http", "::1:8080", "http://localhost:8080", "a b:1", ""]
        {
            assert!(read(wrong).unwrap_err().contains(&format!("got '{wrong}'")), "{wrong}");
        }
    }
}
