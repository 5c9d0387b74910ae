//! Publishing over zenoh, as `zenoh-bridge-ros2dds` takes it: the key expression is the topic without its first slash, the
//! payload the message in CDR with the encapsulation before it. So every ROS 2 that speaks DDS reads it through a bridge, and
//! every program with zenoh without one.
//!
//! Of zenoh's defaults these are changed: nothing is listened at, no multicast is sent, and nobody is dialled but who was
//! asked for; he is dialled again for ever, by a thread of zenoh's.

use crate::Outlet;
use std::fmt;
use std::str::FromStr;
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};

/// Where a bridge or a router of zenoh listens that runs on this machine.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";
/// How long a message may wait for room where others are on their way, microseconds, and all of a large one's parts:
/// what waits is the thread that publishes.
const PATIENCE_US: u64 = 50_000;
const PATIENCE_OF_LARGE_US: u64 = 500_000;

/// Whom to dial: `tcp/HOST:PORT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint(String);

impl FromStr for Endpoint {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // More than host and port would be settings of zenoh's.
        let parts = text.strip_prefix("tcp/").and_then(|rest| rest.rsplit_once(':'));
        let is_plain = |c: char| c.is_ascii_alphanumeric() || ".-_:[]".contains(c);
        match parts {
            Some((host, port))
                if !host.is_empty()
                    && host.chars().all(is_plain)
                    && port.parse::<u16>().is_ok_and(|p| p > 0) =>
            {
                Ok(Self(text.to_owned()))
            }
            _ => Err(format!(
                "{text} is nowhere to publish ROS 2 messages to; give tcp/HOST:PORT of a bridge or router of zenoh, such as \
                 {DEFAULT_ENDPOINT}"
            )),
        }
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Why nothing is published.
#[derive(Debug, thiserror::Error)]
pub enum ZenohError {
    /// Zenoh refuses to begin.
    #[error("zenoh cannot publish to {endpoint}: {reason}")]
    Open {
        /// Whom it was to dial.
        endpoint: Endpoint,
        /// Why not.
        reason: String,
    },
}

/// Publishes over zenoh.
pub struct Zenoh {
    session: zenoh::Session,
}

impl Zenoh {
    /// Begins to publish to whoever listens at `endpoint`; until somebody does, all is dropped.
    ///
    /// # Errors
    /// When zenoh refuses to begin.
    pub fn open(endpoint: &Endpoint) -> Result<Self, ZenohError> {
        let refused = |reason: zenoh::Error| ZenohError::Open {
            endpoint: endpoint.clone(),
            reason: reason.to_string(),
        };
        let config = config(endpoint).map_err(refused)?;
        let session = zenoh::open(config).wait().map_err(refused)?;
        Ok(Self { session })
    }
}

/// Zenoh's configuration.
fn config(endpoint: &Endpoint) -> Result<zenoh::Config, zenoh::Error> {
    let mut config = zenoh::Config::default();
    let drop = "transport/link/tx/queue/congestion_control/drop";
    for (key, value) in [
        ("mode", r#""peer""#.to_owned()),
        ("listen/endpoints", "[]".into()),
        ("connect/endpoints", format!(r#"["{endpoint}"]"#)),
        ("connect/timeout_ms", "-1".into()),
        ("connect/exit_on_failure", "false".into()),
        ("scouting/multicast/enabled", "false".into()),
        ("scouting/gossip/enabled", "false".into()),
        (&format!("{drop}/wait_before_drop"), PATIENCE_US.to_string()),
        (&format!("{drop}/max_wait_before_drop_fragments"), PATIENCE_OF_LARGE_US.to_string()),
    ] {
        config.insert_json5(key, &value)?;
    }
    Ok(config)
}

impl Outlet for Zenoh {
    fn publish(&mut self, topic: &str, message: Vec<u8>) {
        // Where clouds fill the line, poses go first.
        let priority = if message.len() < 4096 { Priority::InteractiveHigh } else { Priority::DataLow };
        let put = self.session.put(topic.trim_start_matches('/'), message);
        // It fails on a session that is closed, which is so only at the end.
        let _ = put.congestion_control(CongestionControl::Drop).priority(priority).wait();
    }
}

impl Drop for Zenoh {
    fn drop(&mut self) {
        // What is on its way is let go first; where the line is dead, zenoh waits for that no longer than 10 s.
        let _ = self.session.close().wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn endpoints_are_a_host_and_a_port() {
        for text in [DEFAULT_ENDPOINT, "tcp/robot.local:1", "tcp/[::1]:7447"] {
            assert_eq!(text.parse::<Endpoint>().unwrap().to_string(), text);
        }
        for text in [
            "7447",
            "udp/127.0.0.1:7447",
            "tls/a:1",
            "tcp/127.0.0.1",
            "tcp/:7447",
            "tcp/a:0",
            "tcp/a:70000",
            "tcp/a:7447#iface=eth0",
            "tcp/a\"]:1",
        ] {
            assert!(text.parse::<Endpoint>().unwrap_err().contains("tcp/HOST:PORT"), "{text}");
        }
    }

    /// Nobody need be there, nothing listens and nobody else is looked for.
    #[test]
    fn publishing_to_nobody_neither_waits_nor_fails() {
        let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let endpoint: Endpoint = format!("tcp/{nobody}").parse().unwrap();
        let config = config(&endpoint).unwrap();
        let output = |key: &str| config.get_json(key).unwrap();
        assert_eq!(output("listen/endpoints"), "[]");
        assert_eq!(
            (output("scouting/multicast/enabled"), output("scouting/gossip/enabled")),
            ("false".into(), "false".into())
        );
        let begun = std::time::Instant::now();
        let mut zenoh = Zenoh::open(&endpoint).unwrap();
        assert!(zenoh.session.info().locators().wait().is_empty(), "it listens");
        (0..1000).for_each(|_| zenoh.publish("/yard/odometry", vec![0; 700]));
        drop(zenoh);
        assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    }
}
