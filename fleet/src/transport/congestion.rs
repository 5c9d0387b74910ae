//! Which congestion control TCP uses. The usual ones take every lost packet for a link that is too full, and over Wi-Fi packets are
//! lost for other reasons: *BBR* (Cardwell et al. 2016) keeps the rate that it measured.

use std::net::TcpStream;

/// As the system calls it.
const BBR: &str = "bbr";

/// Asks the system for BBR. Where it has none, the usual one stays.
pub(super) fn prefer_bbr(socket: &TcpStream) {
    prefer(socket, BBR);
}

#[cfg(target_os = "linux")]
fn prefer(socket: &TcpStream, name: &str) {
    // Refused where its module is not loaded: no link is worse for that than it was.
    let _ = rustix::net::sockopt::set_tcp_congestion(socket, name);
}

#[cfg(not(target_os = "linux"))]
fn prefer(_socket: &TcpStream, _name: &str) {}

#[cfg(all(test, target_os = "linux"))]
pub(super) mod tests {
    use super::*;
    use rustix::net::sockopt::tcp_congestion;
    use std::io::{Read, Write};
    use std::net::TcpListener;

    /// What the system says under this name of its congestion controls.
    fn of_system(name: &str) -> String {
        let text = std::fs::read_to_string(format!("/proc/sys/net/ipv4/{name}")).unwrap();
        text.trim().to_owned()
    }

    /// What a socket is to have: BBR where there is BBR, else what the system gives it.
    pub fn expected() -> String {
        let available = of_system("tcp_available_congestion_control");
        if available.split(' ').any(|name| name == BBR) {
            BBR.into()
        } else {
            of_system("tcp_congestion_control")
        }
    }

    fn pair() -> [TcpStream; 2] {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let one = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        [one, listener.accept().unwrap().0]
    }

    #[test]
    fn a_socket_gets_what_the_system_has_and_keeps_what_it_had_where_it_has_none() {
        let [mut one, mut other] = pair();
        // Every Linux has Reno's.
        prefer(&one, "reno");
        assert_eq!(tcp_congestion(&one).unwrap(), "reno");
        prefer(&one, "nobody's");
        assert_eq!(tcp_congestion(&one).unwrap(), "reno");
        for socket in [&one, &other] {
            prefer_bbr(socket);
        }
        let is_there = expected() == BBR;
        assert_eq!(tcp_congestion(&one).unwrap(), if is_there { BBR } else { "reno" });
        assert_eq!(tcp_congestion(&other).unwrap(), expected());
        let sent = vec![7; 100_000];
        let writing = {
            let sent = sent.clone();
            std::thread::spawn(move || one.write_all(&sent))
        };
        let mut came = vec![0; sent.len()];
        other.read_exact(&mut came).unwrap();
        writing.join().unwrap().unwrap();
        assert!(came == sent);
    }
}
