//! Words to the service manager, systemd's protocol `sd_notify`: datagrams to the socket that `NOTIFY_SOCKET` names.

use std::ffi::OsString;
use std::os::unix::net::{SocketAddr, UnixDatagram};

/// Who started this program as a service, or nobody.
pub struct Manager(Option<(UnixDatagram, SocketAddr)>);

impl Manager {
    /// The one that the environment names.
    pub fn of_environment() -> Self {
        Self::at(std::env::var_os("NOTIFY_SOCKET"))
    }

    fn at(socket: Option<OsString>) -> Self {
        let address = socket.and_then(|name| address(&name));
        Self(address.and_then(|address| Some((UnixDatagram::unbound().ok()?, address))))
    }

    /// Notifies it; what does not arrive is sent again with the next beat.
    pub fn notify(&self, text: &str) {
        if let Some((socket, address)) = &self.0 {
            let _ = socket.send_to_addr(text.as_bytes(), address);
        }
    }
}

/// A path, or behind `@` a name of Linux's abstract sockets.
fn address(name: &OsString) -> Option<SocketAddr> {
    match name.to_str().and_then(|name| name.strip_prefix('@')) {
        #[cfg(target_os = "linux")]
        Some(name) => <SocketAddr as std::os::linux::net::SocketAddrExt>::from_abstract_name(name).ok(),
        #[cfg(not(target_os = "linux"))]
        Some(_) => None,
        None => SocketAddr::from_pathname(name).ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_manager_receives_what_it_is_sent() {
        let room = tempfile::tempdir().expect("a folder");
        let path = room.path().join("notify");
        let receiver = UnixDatagram::bind(&path).expect("a socket");
        Manager::at(Some(path.into())).notify("READY=1");
        let mut bytes = [0; 64];
        let count = receiver.recv(&mut bytes).expect("it was sent");
        assert_eq!(&bytes[..count], b"READY=1");
        // Nobody is told nothing.
        Manager::at(None).notify("READY=1");
        Manager::at(Some("/nowhere/notify".into())).notify("READY=1");
    }
}
