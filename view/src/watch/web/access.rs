//! Who may look: only this machine, unless a token says otherwise.

use anyhow::{Context, Result, bail};
use std::net::IpAddr;
use subtle::ConstantTimeEq;

/// Bytes of a token that is made here: as many as nobody guesses.
const TOKEN_BYTES: usize = 16;
/// Characters that a token given by the user has at least.
const SHORTEST_TOKEN: usize = 8;

/// Where to serve, and to whom.
#[derive(Clone, Debug)]
pub struct Address {
    ip: IpAddr,
    /// The port; without one a usual one, or any that is free.
    pub port: Option<u16>,
    token: Option<String>,
}

impl Address {
    /// An address of this machine's own needs no token; for any other one is made if none is given.
    ///
    /// # Errors
    /// When the token is too short or cannot stand in an address, or the system has no random numbers.
    pub fn new(ip: IpAddr, port: Option<u16>, token: Option<String>) -> Result<Self> {
        if let Some(token) = &token {
            let plain = |c: char| c.is_ascii_alphanumeric() || "-_.~".contains(c);
            if token.len() < SHORTEST_TOKEN || !token.chars().all(plain) {
                bail!(
                    "--token: not a token\nhint: give {SHORTEST_TOKEN} or more letters, digits, '-', '_', '.' or '~', or leave \
                     it out: one is made for --bind"
                );
            }
        }
        let token = match token {
            None if !ip.is_loopback() => Some(new_token()?),
            token => token,
        };
        Ok(Self { ip, port, token })
    }

    /// The address to listen at.
    pub fn ip(&self) -> IpAddr {
        self.ip
    }

    /// What comes after the `/` of the page's address.
    pub fn query(&self) -> String {
        self.token.as_ref().map_or(String::new(), |token| format!("?token={token}"))
    }

    /// Whether a request may be answered, and why not.
    ///
    /// Without a token, `host` must be a name of this machine's own: else a page of someone else whose name was
    /// bound to 127.0.0.1 (DNS rebinding) could read what is served. A WebSocket may be opened from any page of the
    /// web, so its `origin`, which browsers always send, must be the page served here.
    ///
    /// # Errors
    /// The reason, for people.
    pub fn admit(&self, request: &Visit) -> Result<(), &'static str> {
        let Some(host) = request.host else { return Err("the request names no host") };
        if self.token.is_none() && !is_own_name(host) {
            return Err("this page is served to this machine only: open it by 127.0.0.1 or localhost");
        }
        // Who serves others may have a proxy before it that speaks HTTPS.
        let schemes: &[&str] = if self.token.is_some() { &["http://", "https://"] } else { &["http://"] };
        let is_own = |origin: &str| schemes.iter().any(|scheme| origin.strip_prefix(scheme) == Some(host));
        if request.origin.is_some_and(|origin| !is_own(origin)) {
            return Err("another page may not look at this one's run");
        }
        let mut given = [request.token, request.kept_token, request.bearer].into_iter().flatten();
        if self.token.is_some() && !given.any(|token| self.is_token(token)) {
            return Err("the token is missing or wrong: open the address that the program printed");
        }
        Ok(())
    }

    /// Whether this is the token.
    pub fn is_token(&self, given: &str) -> bool {
        self.token.as_ref().is_some_and(|token| token.as_bytes().ct_eq(given.as_bytes()).into())
    }
}

/// What a request says of who sent it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Visit<'a> {
    /// The header `Host`.
    pub host: Option<&'a str>,
    /// The header `Origin`.
    pub origin: Option<&'a str>,
    /// The token in the request's address.
    pub token: Option<&'a str>,
    /// The token that the browser kept.
    pub kept_token: Option<&'a str>,
    /// The token in the header `Authorization`, as programs send it.
    pub bearer: Option<&'a str>,
}

/// Whether a host, with or without a port, is this machine's own for itself. The port is free: it differs where a
/// port is forwarded.
pub fn is_own_name(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if !port.is_empty() && port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    };
    ["127.0.0.1", "localhost", "[::1]"].contains(&name)
}

fn new_token() -> Result<String> {
    let mut bytes = [0u8; TOKEN_BYTES];
    getrandom::fill(&mut bytes)
        .context("the system gives no random numbers for a token\nhint: give --token")?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOCAL: &str = "127.0.0.1:7171";

    fn address(ip: &str, token: Option<&str>) -> Address {
        Address::new(ip.parse().expect("an address"), None, token.map(Into::into)).expect("a fine token")
    }

    fn visit<'a>(host: &'a str, origin: Option<&'a str>, token: Option<&'a str>) -> Visit<'a> {
        Visit { host: Some(host), origin, token, ..Visit::default() }
    }

    #[test]
    fn this_machine_needs_no_token_but_its_own_name() {
        let own = address("127.0.0.1", None);
        assert_eq!(own.query(), "");
        for host in [LOCAL, "localhost:9000", "localhost", "[::1]:7171"] {
            assert!(own.admit(&visit(host, None, None)).is_ok(), "{host}");
            assert!(own.admit(&visit(host, Some(&format!("http://{host}")), None)).is_ok(), "{host}");
        }
        for host in ["evil.example:7171", "127.0.0.1.evil.example", "localhost.evil.example:7171", ""] {
            assert!(own.admit(&visit(host, None, None)).is_err(), "{host}");
        }
        for origin in ["http://evil.example", "null", "https://127.0.0.1:7171", "http://127.0.0.1:8000"] {
            assert!(own.admit(&visit(LOCAL, Some(origin), None)).is_err(), "{origin}");
        }
        assert!(own.admit(&Visit::default()).is_err());
    }

    #[test]
    fn other_machines_need_the_token() {
        let open = address("0.0.0.0", Some("0123456789abcdef"));
        let admit = |token| open.admit(&visit("192.168.0.7:7171", None, token));
        assert!(admit(Some("0123456789abcdef")).is_ok());
        for wrong in
            [None, Some(""), Some("0123456789abcde"), Some("0123456789abcdeF"), Some("0123456789abcdef0")]
        {
            assert!(admit(wrong).is_err(), "{wrong:?}");
        }
        let kept = |token| Visit { kept_token: Some(token), ..visit("192.168.0.7:7171", None, None) };
        assert!(open.admit(&kept("0123456789abcdef")).is_ok());
        assert!(open.admit(&kept("0123456789abcdeF")).is_err());
        let bearer = |token| Visit { bearer: Some(token), ..visit("192.168.0.7:7171", None, None) };
        assert!(open.admit(&bearer("0123456789abcdef")).is_ok());
        assert!(open.admit(&bearer("0123456789abcdeF")).is_err());
        let foreign = visit("192.168.0.7:7171", Some("http://evil.example"), Some("0123456789abcdef"));
        assert!(open.admit(&foreign).is_err());
        let behind_a_proxy = visit("robot.example", Some("https://robot.example"), Some("0123456789abcdef"));
        assert!(open.admit(&behind_a_proxy).is_ok());
    }

    #[test]
    fn a_token_is_made_where_one_is_needed() {
        let (one, other) = (address("0.0.0.0", None).query(), address("192.168.0.7", None).query());
        assert_eq!(one.len(), "?token=".len() + 2 * TOKEN_BYTES);
        assert_ne!(one, other);
        for bad in ["short", "with blank 123", "ümläütümläüt"] {
            assert!(Address::new(IpAddr::from([0, 0, 0, 0]), None, Some(bad.into())).is_err(), "{bad}");
        }
    }
}
