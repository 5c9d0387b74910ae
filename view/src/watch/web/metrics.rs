//! What a page knows, as Prometheus reads it at `/metrics`: its text format, version 0.0.4.
//!
//! Nothing is counted here: every number is what the page shows at the moment, so there is no registry that could say another.

use super::page::Mode;
use crate::process;
use crate::watch::{Neighbour, Neighbourhood, Status};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The media type of the text.
pub const KIND: &str = "text/plain; version=0.0.4";
/// What a run may be doing.
const STATES: [&str; 5] = ["preparing", "starting", "tracking", "lost", "done"];

/// All that is known: whether the agent is well where somebody asks after it, and what is shown where anything is.
pub fn text(is_well: Option<bool>, displayed: Option<(Mode, Status)>) -> String {
    let mut out = Exposition::default();
    out.gauge(
        "loopbox_build_info",
        "The version of the program, as a label.",
        [(vec![("version", env!("CARGO_PKG_VERSION"))], 1.0)],
    );
    if let Some(seconds) = process::cpu_seconds() {
        out.counter("process_cpu_seconds_total", "CPU time of the program, seconds.", one(seconds));
    }
    if let Some(bytes) = process::memory_bytes() {
        out.gauge("process_resident_memory_bytes", "Resident memory of the program.", one(bytes as f64));
    }
    if let Some(is_well) = is_well {
        let help = "Whether /health says that the agent does its work.";
        out.gauge("loopbox_healthy", help, one(f64::from(u8::from(is_well))));
    }
    if let Some((mode, status)) = &displayed {
        out.gauge("loopbox_keyframes", "Keyframes of the map that is shown.", one(status.keyframes as f64));
        out.gauge("loopbox_points", "Points of the map that is shown.", one(status.points as f64));
        if matches!(mode, Mode::Live | Mode::Service) {
            out.run(status);
        }
        status.neighbourhood.iter().for_each(|near| out.fleet(near));
    }
    out.0
}

/// Labels of a sample with their values.
type Labels<'a> = Vec<(&'a str, &'a str)>;

/// A number alone.
fn one<'a>(value: f64) -> [(Labels<'a>, f64); 1] {
    [(Vec::new(), value)]
}

/// The text as it grows, family by family.
#[derive(Default)]
struct Exposition(String);

impl Exposition {
    /// What only grows, but for a new beginning.
    fn counter<'a>(&mut self, name: &str, help: &str, samples: impl IntoIterator<Item = (Labels<'a>, f64)>) {
        self.family(name, ("counter", help), samples);
    }

    /// What rises and falls.
    fn gauge<'a>(&mut self, name: &str, help: &str, samples: impl IntoIterator<Item = (Labels<'a>, f64)>) {
        self.family(name, ("gauge", help), samples);
    }

    fn family<'a>(
        &mut self,
        name: &str,
        (kind, help): (&str, &str),
        samples: impl IntoIterator<Item = (Labels<'a>, f64)>,
    ) {
        let out = &mut self.0;
        // Writing to a text does not fail.
        let _ = writeln!(out, "# HELP {name} {}\n# TYPE {name} {kind}", escaped(help, false));
        for (labels, value) in samples {
            let labels: Vec<String> =
                labels.iter().map(|(label, value)| format!("{label}=\"{}\"", escaped(value, true))).collect();
            let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
            let _ = writeln!(out, "{name}{labels} {}", number(value));
        }
    }

    /// What is known of a run.
    fn run(&mut self, status: &Status) {
        let states = STATES.map(|state| (vec![("state", state)], f64::from(u8::from(state == status.state))));
        self.gauge("loopbox_state", "What the run does: 1 for that, 0 for all else.", states);
        self.gauge("loopbox_paused", "Whether a user paused the run.", one(u8::from(status.paused).into()));
        for (name, help, count) in [
            ("loopbox_frames_total", "Frames that were processed.", status.processed),
            ("loopbox_frames_tracked_total", "Frames of which the pose was tracked.", status.tracked),
            ("loopbox_frames_dropped_total", "Frames dropped because tracking was late.", status.dropped),
            ("loopbox_losses_total", "Times that tracking was lost.", status.losses),
            ("loopbox_loops_closed_total", "Loops closed in the map that is shown.", status.loops),
            (
                "loopbox_scale_breaks_total",
                "Times that the scale was not carried on.",
                status.scale_break.as_ref().map_or(0, |breaks| breaks.count),
            ),
        ] {
            self.counter(name, help, one(count as f64));
        }
        self.gauge("loopbox_frame_seconds", "Time that the newest frame took.", one(status.ms / 1e3));
        if let Some(ms) = status.latency_ms {
            self.gauge(
                "loopbox_latency_seconds",
                "From capture to pose, of the newest frame.",
                one(ms / 1e3),
            );
        }
        let share = f64::from(status.inlier_share);
        self.gauge("loopbox_inlier_ratio", "Share of the newest frame's points that match, 0–1.", one(share));
        self.gauge(
            "loopbox_matched_points",
            "Points matched in the newest frame.",
            one(status.matched as f64),
        );
    }

    /// What is known of a fleet.
    fn fleet(&mut self, near: &Neighbourhood) {
        let connected = near.links.iter().filter(|link| link.address.is_some()).count();
        let help = "Peers with which there is a link.";
        self.gauge("loopbox_fleet_peers_connected", help, one(connected as f64));
        let help = "Peers that are known, connected or not.";
        self.gauge("loopbox_fleet_peers_known", help, one(peers(near).count() as f64));
        let help = "Addresses that are dialled and at which nobody answers.";
        let unanswered = near.links.len() - peers(near).count();
        self.gauge("loopbox_fleet_addresses_unanswered", help, one(unanswered as f64));
        let up = |link: &Neighbour| u64::from(link.address.is_some());
        self.gauge("loopbox_fleet_peer_up", "Links to a peer.", by_peer(near, up));
        let help = "Bytes of objects that came from a peer.";
        self.counter("loopbox_fleet_received_bytes_total", help, by_peer(near, |link| link.received));
        let help = "Bytes of these that were here already.";
        self.counter("loopbox_fleet_repeated_bytes_total", help, by_peer(near, |link| link.useless));
        let help = "Objects that are to be fetched from a peer.";
        self.gauge("loopbox_fleet_wanted_objects", help, by_peer(near, |link| link.wanted as u64));
        if near.links.iter().any(|link| link.lacks.is_some()) {
            let help = "Objects of this agent's own map that a peer has not acknowledged.";
            let lacks = by_peer(near, |link| link.lacks.unwrap_or_default());
            self.gauge("loopbox_fleet_lacking_objects", help, lacks);
        }
        let counts = &near.counts;
        for (name, help, count) in [
            ("loopbox_fleet_maps", "Maps of others that are told here.", counts.maps),
            ("loopbox_fleet_maps_finished", "Those whose run has ended.", counts.finished),
            ("loopbox_fleet_maps_joined", "Those that were joined with another map.", counts.joined),
            ("loopbox_fleet_missing_objects", "Objects of them that are not here yet.", counts.missing),
        ] {
            self.gauge(name, help, one(count as f64));
        }
        let states: Vec<(String, f64)> =
            counts.pairs.iter().map(|(state, count)| (state.replace(' ', "_"), *count as f64)).collect();
        let pairs = states.iter().map(|(state, count)| (vec![("state", &**state)], *count));
        self.gauge("loopbox_fleet_pairs", "Pairs of maps that were looked at here, by their verdict.", pairs);
    }
}

/// The neighbours, without the addresses at which nobody answers: who would is not known, or is a neighbour beside.
fn peers(near: &Neighbourhood) -> impl Iterator<Item = &Neighbour> {
    near.links.iter().filter(|link| link.why.is_none())
}

/// A number of each peer by its name; of peers of one name their sum.
fn by_peer(near: &Neighbourhood, number: impl Fn(&Neighbour) -> u64) -> Vec<(Labels<'_>, f64)> {
    let mut sums: BTreeMap<&str, u64> = BTreeMap::new();
    for link in peers(near) {
        *sums.entry(&link.name).or_default() += number(link);
    }
    sums.into_iter().map(|(name, sum)| (vec![("peer", name)], sum as f64)).collect()
}

/// A number as the format writes it.
fn number(value: f64) -> String {
    match value {
        f64::INFINITY => "+Inf".into(),
        f64::NEG_INFINITY => "-Inf".into(),
        value => value.to_string(),
    }
}

/// A text in which nothing ends its line or, of a label, its quotes.
fn escaped(text: &str, is_label: bool) -> String {
    let text = text.replace('\\', "\\\\").replace('\n', "\\n");
    if is_label { text.replace('"', "\\\"") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::watch::FleetCounts;

    /// A family: its kind, and its samples by their labels.
    type Family = (String, BTreeMap<Vec<(String, String)>, f64>);

    /// A value in quotes, its escapes undone, and what comes after it.
    fn quoted(text: &str) -> (String, &str) {
        let (mut value, mut rest) = (String::new(), text.strip_prefix('"').expect("a quote").chars());
        loop {
            match rest.next().expect("an end of the value") {
                '"' => return (value, rest.as_str()),
                '\\' => value.push(match rest.next() {
                    Some('n') => '\n',
                    Some(c @ ('\\' | '"')) => c,
                    other => panic!("no escape: {other:?}"),
                }),
                c => value.push(c),
            }
        }
    }

    /// The families of a text by their names, read as the format's description says.
    fn parsed(text: &str) -> BTreeMap<String, Family> {
        let mut families: BTreeMap<String, Family> = BTreeMap::new();
        let (mut helped, mut current) = (String::new(), String::new());
        assert!(text.ends_with('\n'), "the last line has an end");
        for line in text.lines() {
            if let Some(help) = line.strip_prefix("# HELP ") {
                helped = help.split_once(' ').expect("a help").0.to_owned();
                continue;
            }
            if let Some(of) = line.strip_prefix("# TYPE ") {
                let (name, kind) = of.split_once(' ').expect("a type");
                assert_eq!(name, helped, "the help of each stands before its type");
                assert_eq!(kind == "counter", name.ends_with("_total"), "{name} is a {kind}");
                current = name.to_owned();
                assert!(
                    families.insert(current.clone(), (kind.into(), BTreeMap::new())).is_none(),
                    "{name} twice"
                );
                continue;
            }
            let end = line.find(['{', ' ']).expect("a sample");
            let (name, mut rest) = line.split_at(end);
            assert_eq!(name, current, "samples stand together, after their type");
            assert!(name.chars().all(|c| c.is_ascii_lowercase() || c == '_'), "{name}");
            let mut labels = Vec::new();
            while let Some(more) = rest.strip_prefix(['{', ',']) {
                let (label, value) = more.split_once('=').expect("a label");
                let (value, after) = quoted(value);
                labels.push((label.to_owned(), value));
                rest = after.strip_prefix('}').unwrap_or(after);
            }
            let value = rest.trim_start().parse().expect("a number");
            let (_, samples) = families.get_mut(name).expect("its family");
            assert!(samples.insert(labels, value).is_none(), "{line} twice");
        }
        families
    }

    fn near() -> Neighbourhood {
        let link = |name: &str, address: Option<&str>, received, useless| Neighbour {
            name: name.into(),
            address: address.map(Into::into),
            received,
            useless,
            lacks: Some(3),
            ..Neighbour::default()
        };
        let pairs = BTreeMap::from([("accepted".to_owned(), 2), ("not yet".to_owned(), 7)]);
        let counts = FleetCounts { maps: 3, finished: 1, joined: 2, missing: 40, pairs };
        let odd = "a \"robot\" in C:\\yard\nof two lines";
        let nobody =
            Neighbour { why: Some("Connection refused".into()), ..link("tls/base:7447", None, 0, 0) };
        let links = vec![
            nobody,
            link(odd, Some("tls/10.0.0.7:7447"), 1000, 10),
            link("car", None, 5, 0),
            link("car", None, 6, 0),
        ];
        Neighbourhood { links, counts, ..Neighbourhood::default() }
    }

    #[test]
    fn metrics_can_be_read_again() {
        let status = Status {
            state: "lost",
            processed: 1 << 40,
            tracked: 90,
            losses: 2,
            keyframes: 12,
            ms: 12.5,
            latency_ms: Some(f64::INFINITY),
            inlier_share: f32::NAN,
            neighbourhood: Some(near()),
            ..Status::default()
        };
        let families = parsed(&text(Some(false), Some((Mode::Live, status))));
        let value = |name: &str, labels: &[(&str, &str)]| {
            let labels: Vec<_> =
                labels.iter().map(|(label, value)| ((*label).into(), (*value).into())).collect();
            families[name].1[&labels]
        };
        assert_eq!(families["loopbox_frames_total"].0, "counter");
        assert_eq!(value("loopbox_frames_total", &[]), (1u64 << 40) as f64);
        assert_eq!(value("loopbox_frames_tracked_total", &[]), 90.0);
        assert_eq!(value("loopbox_losses_total", &[]), 2.0);
        assert_eq!(
            (families["loopbox_keyframes"].0.as_str(), value("loopbox_keyframes", &[])),
            ("gauge", 12.0)
        );
        assert_eq!(value("loopbox_frame_seconds", &[]), 0.0125);
        assert_eq!(value("loopbox_latency_seconds", &[]), f64::INFINITY);
        assert!(value("loopbox_inlier_ratio", &[]).is_nan());
        assert_eq!(value("loopbox_healthy", &[]), 0.0);
        let states: Vec<f64> = families["loopbox_state"].1.values().copied().collect();
        assert_eq!((value("loopbox_state", &[("state", "lost")]), states.iter().sum::<f64>()), (1.0, 1.0));
        let odd = [("peer", "a \"robot\" in C:\\yard\nof two lines")];
        assert_eq!(value("loopbox_fleet_received_bytes_total", &odd), 1000.0);
        assert_eq!(value("loopbox_fleet_repeated_bytes_total", &odd), 10.0);
        assert_eq!(value("loopbox_fleet_peer_up", &odd), 1.0);
        assert_eq!(
            value("loopbox_fleet_received_bytes_total", &[("peer", "car")]),
            11.0,
            "of both of the name"
        );
        assert_eq!(value("loopbox_fleet_lacking_objects", &[("peer", "car")]), 6.0);
        assert_eq!(value("loopbox_fleet_peers_connected", &[]), 1.0);
        assert_eq!(value("loopbox_fleet_peers_known", &[]), 3.0);
        assert_eq!(value("loopbox_fleet_addresses_unanswered", &[]), 1.0);
        assert_eq!(families["loopbox_fleet_peer_up"].1.len(), 2, "an address is no peer");
        assert_eq!(value("loopbox_fleet_pairs", &[("state", "not_yet")]), 7.0);
        assert_eq!(value("loopbox_fleet_missing_objects", &[]), 40.0);
    }

    #[test]
    fn of_what_is_no_run_no_frames_are_counted() {
        let status = Status { state: "collecting", neighbourhood: Some(near()), ..Status::default() };
        let station = parsed(&text(None, Some((Mode::Station, status))));
        assert!(station.contains_key("loopbox_fleet_maps") && station.contains_key("loopbox_keyframes"));
        assert!(!station.contains_key("loopbox_frames_total") && !station.contains_key("loopbox_healthy"));
        let between_runs = parsed(&text(Some(true), None));
        assert_eq!(between_runs["loopbox_healthy"].1[&Vec::new()], 1.0);
        assert!(!between_runs.contains_key("loopbox_keyframes"));
    }
}
