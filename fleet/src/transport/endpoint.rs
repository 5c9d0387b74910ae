//! Where a node listens or whom it dials.

use anyhow::{Context, Result, bail};
use std::fmt;
use std::io::{self, ErrorKind};
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::str::FromStr;

const HINT: &str = "hint: an address is tls/HOST:PORT, such as tls/station.example:7447, or within this machine \
                    tcp/127.0.0.1:PORT";

/// `tls/HOST:PORT`, or `tcp/HOST:PORT` within this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Whether with TLS.
    pub secure: bool,
    /// A name, or an address without brackets.
    pub host: String,
    /// The port.
    pub port: u16,
}

impl Endpoint {
    /// The addresses by now, those first that others of this kind of program listen at.
    ///
    /// # Errors
    /// When nothing has this name.
    pub fn resolve(&self) -> io::Result<Vec<SocketAddr>> {
        let describe = |what: &dyn fmt::Display| format!("{self} is not found: {what}");
        let found = (self.host.as_str(), self.port)
            .to_socket_addrs()
            .map_err(|error| io::Error::new(error.kind(), describe(&error)))?;
        let mut found: Vec<SocketAddr> = found.collect();
        found.sort_by_key(SocketAddr::is_ipv6);
        if found.is_empty() {
            return Err(io::Error::new(ErrorKind::NotFound, describe(&"it has no address")));
        }
        Ok(found)
    }

    /// At this port instead, which the system gave.
    pub fn at_port(&self, port: u16) -> Self {
        Self { port, ..self.clone() }
    }

    /// What others dial: of one that listens everywhere the machine's name is theirs to say.
    pub fn for_others(&self) -> String {
        match self.host.parse::<IpAddr>() {
            Ok(ip) if ip.is_unspecified() => {
                format!("tls/HOST:{}, HOST a name or an address of this machine", self.port)
            }
            _ => self.to_string(),
        }
    }
}

impl FromStr for Endpoint {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let refuse = || format!("{text} is no address that can be listened at or dialled\n{HINT}");
        let (secure, rest) = match text.split_once('/') {
            Some(("tls", rest)) => (true, rest),
            Some(("tcp", rest)) => (false, rest),
            _ => bail!(refuse()),
        };
        let (host, port) = rest.rsplit_once(':').with_context(refuse)?;
        let host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
        let is_plain = |c: char| !c.is_whitespace() && !c.is_control() && !"/@[]".contains(c);
        if host.is_empty() || !host.chars().all(is_plain) {
            bail!(refuse());
        }
        Ok(Self { secure, host: host.to_owned(), port: port.parse().ok().with_context(refuse)? })
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.secure { "tls" } else { "tcp" };
        match self.host.contains(':') {
            true => write!(f, "{kind}/[{}]:{}", self.host, self.port),
            false => write!(f, "{kind}/{}:{}", self.host, self.port),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_written() {
        for text in ["tls/station.example:7447", "tcp/127.0.0.1:0", "tls/[::1]:7447", "tls/0.0.0.0:1"] {
            assert_eq!(text.parse::<Endpoint>().unwrap().to_string(), text);
        }
        for text in
            ["7447", "udp/127.0.0.1:7447", "tcp/127.0.0.1", "tls/:7", "tls/a:70000", "tls/a b:7", "tls/a/b:7"]
        {
            let refused = text.parse::<Endpoint>().expect_err(text).to_string();
            assert!(refused.contains("hint"), "{refused}");
        }
        assert_eq!(
            "tls/[::1]:7".parse::<Endpoint>().unwrap().resolve().unwrap(),
            ["[::1]:7".parse().unwrap()]
        );
        let nowhere = "tls/nowhere.invalid:1".parse::<Endpoint>().unwrap().resolve();
        assert!(nowhere.unwrap_err().to_string().contains("tls/nowhere.invalid:1 is not found"));
    }
}
