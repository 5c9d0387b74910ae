use super::*;
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::Index;

/// Agents by name, each with its root and how far along x and by which scale it stands in the root's world.
fn found(agents: &[(&str, &str, f64, f64)]) -> MergeResults {
    let agent = |(agent, root, x, scale): &(&str, &str, f64, f64)| PlacedAgent {
        agent: (*agent).into(),
        name: (*agent).into(),
        keyframes: 9,
        whole: true,
        root: (*root).into(),
        root_from_agent: [*x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, *scale],
    };
    MergeResults { agents: agents.iter().map(agent).collect(), pair_verdicts: Vec::new() }
}

fn places(found: &MergeResults) -> Vec<(&str, &str, f64, f64)> {
    let place = |agent: &PlacedAgent| agent.root_from_agent;
    let agents = found.agents.iter();
    agents.map(|a| (a.agent.as_str(), a.root.as_str(), place(a)[0], place(a)[7])).collect()
}

/// The map of one agent is whole and was looked at alone, then parts of it and of another's meet.
#[test]
fn who_was_alone_is_placed_by_whom_it_meets() {
    let alone = found(&[("b", "b", 0.0, 1.0)]);
    let parts = found(&[("a", "a", 0.0, 1.0), ("b", "a", 4.0, 2.0)]);
    assert_eq!(places(&parts.overlaid_by(&alone)), [("b", "a", 4.0, 2.0), ("a", "a", 0.0, 1.0)]);
}

#[test]
fn components_that_meet_by_parts_become_one() {
    let whole =
        found(&[("a", "a", 0.0, 1.0), ("b", "a", 4.0, 2.0), ("c", "c", 0.0, 1.0), ("d", "c", 1.0, 1.0)]);
    // d's world begins one of b's units, two of a's, from b's, and has b's scale.
    let parts = found(&[("b", "b", 0.0, 1.0), ("d", "b", 1.0, 1.0)]);
    let together = [("a", "a", 0.0, 1.0), ("b", "a", 4.0, 2.0), ("c", "a", 4.0, 2.0), ("d", "a", 6.0, 2.0)];
    assert_eq!(places(&parts.overlaid_by(&whole)), together);
    // What whole maps say of each other stands.
    let other = found(&[("a", "a", 0.0, 1.0), ("b", "a", 5.0, 3.0)]);
    assert_eq!(places(&other.overlaid_by(&whole)), places(&whole));
    assert_eq!(places(&MergeResults::default().overlaid_by(&whole)), places(&whole));
}

#[test]
fn places_where_none_can_be_are_refused() {
    let read = |found: &MergeResults| MergeResults::from_bytes(&found.to_bytes());
    let results = found(&[("a", "a", 0.0, 1.0), ("b", "a", 4.0, 2.0)]);
    assert_eq!(read(&results), Ok(results.clone()));
    for (number, value) in [(6, 0.0), (6, 2.0), (7, 0.0), (7, -1.0)] {
        let mut wrong = results.clone();
        wrong.agents[1].root_from_agent[number] = value;
        assert!(read(&wrong).unwrap_err().contains("the place of \"b\" is none"), "{number} {value}");
    }
    // What JSON has no number for is written as null.
    let mut wrong = results.clone();
    wrong.agents[1].root_from_agent[0] = f64::NAN;
    assert!(read(&wrong).is_err());
    let huge = String::from_utf8(results.to_bytes()).unwrap().replace("4.0", "4e999");
    assert!(MergeResults::from_bytes(huge.as_bytes()).is_err());
}

/// What a neighbour may tell: agents that share roots, or have roots that nobody has, and any meetings of them.
fn anything() -> impl Strategy<Value = MergeResults> {
    let agent = (0..5u8, 0..7u8, -1e6..1e6f64, 1e-3..1e3f64);
    let pair = (0..7u8, 0..7u8, 0..3usize, any::<bool>());
    (vec(agent, 0..6), vec(pair, 0..9)).prop_map(|(agents, pair_verdicts)| {
        let agents = agents.into_iter().map(|(agent, root, x, scale)| PlacedAgent {
            agent: agent.to_string(),
            name: format!("\"{agent}\u{e9}"),
            keyframes: 9,
            whole: true,
            root: root.to_string(),
            root_from_agent: [x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, scale],
        });
        let pair_verdicts = pair_verdicts.into_iter().map(|(a, b, verdict, pending)| PairVerdict {
            names: [a, b].map(|agent| agent.to_string()),
            agents: [a, b].map(|agent| agent.to_string()),
            verdict: ["accepted", "undecided", "refused"][verdict].into(),
            why: pending.then(|| "it is looked at".into()),
            pending,
        });
        MergeResults { agents: agents.collect(), pair_verdicts: pair_verdicts.collect() }
    })
}

/// So many agents, of which every two were looked at, each with a reason of its own, as reasons are.
fn of_hundreds(count: usize) -> (Vec<String>, MergeResults) {
    let named =
        |number: usize| (format!("00000000-0000-8000-8000-{number:012}/0"), format!("agent-{number:03}"));
    let agents: Vec<String> = (0..count).map(|number| named(number).0).collect();
    let mut results =
        found(&agents.iter().map(|agent| (&**agent, &*agents[0], 0.5, 1.0)).collect::<Vec<_>>());
    for (a, b) in (0..count).flat_map(|b| (0..b).map(move |a| (a, b))) {
        let ((one, first), (other, second)) = (named(a), named(b));
        let reason = format!(
            "0.{a:03} of all pixels with depth agree with what the other one saw, and 0.{b:03} of those near; 0.25 are \
             needed: things that repeat look like that"
        );
        let verdict = if a + 1 == b { ACCEPTED } else { "refused" };
        let why = (verdict != ACCEPTED).then_some(reason);
        let (names, agents, verdict) = ([first, second], [one, other], verdict.to_owned());
        results.pair_verdicts.push(PairVerdict { names, agents, verdict, why, pending: false });
    }
    (agents, results)
}

#[test]
fn of_hundreds_of_agents_each_receives_all_that_concerns_it() {
    let limit = crate::manifest::MAX_LIST as usize;
    for count in [100, 300] {
        let (agents, all) = of_hundreds(count);
        assert!(count < 300 || all.to_bytes().len() > limit);
        let all = ByAgent::new(all.into());
        for own in [0, count / 2, count - 1] {
            let bytes = all.about(&[agents[own].clone()].into()).to_bytes_within(limit);
            assert!(bytes.len() < limit / 4, "{}", bytes.len());
            let read = MergeResults::from_bytes(&bytes).unwrap();
            assert_eq!((read.agents.len(), read.pair_verdicts.len()), (count, count - 1));
            assert_eq!(read.agents[0].agent, agents[own]);
            assert_eq!(read.accepted(), if own == 0 || own == count - 1 { 1 } else { 2 });
        }
    }
    // A station that tells nothing itself is told what fits: who met before who did not.
    let (_, all) = of_hundreds(300);
    let bytes = ByAgent::new(all.into()).about(&BTreeSet::new()).to_bytes_within(limit);
    let read = MergeResults::from_bytes(&bytes).unwrap();
    assert!(bytes.len() <= limit && read.agents.len() == 300 && read.accepted() == 299);
    assert!(read.pair_verdicts.len() > 300);
}

#[test]
fn versions_before_are_understood_and_pairs_of_nobody_and_endless_texts_are_not() {
    let mut results = found(&[("a", "a", 0.0, 1.0)]);
    let (names, agents) = (["a".into(), "b".into()], ["a".into(), "b".into()]);
    results.pair_verdicts.push(PairVerdict {
        names,
        agents,
        verdict: "accepted".into(),
        why: None,
        pending: false,
    });
    let before = serde_json::to_vec(&results).unwrap();
    assert_eq!(MergeResults::from_bytes(&before), Ok(results));
    let read = |text: &str| MergeResults::from_bytes(text.as_bytes()).unwrap_err();
    assert!(
        read(r#"{"who":[["a","a"]],"texts":["x"],"pairs":[[0,1,0,null,false]]}"#).contains("agent 1 of 1")
    );
    assert!(read(r#"{"who":[["a","a"]],"texts":["x"],"pairs":[[0,0,0,7,false]]}"#).contains("text 7 of 1"));
    let pairs = vec!["[0,0,0,0,false]"; 1000].join(",");
    let long = format!(r#"{{"who":[["a","a"]],"texts":["{}"],"pairs":[{pairs}]}}"#, "x".repeat(1 << 19));
    assert!(read(&long).contains("more text than may be told"));
}

proptest! {
    /// Bytes of a message that was told, some of them damaged, are refused or say what can be.
    #[test]
    fn damaged_bytes_are_refused_or_say_what_can_be(
        results in anything(), damage in vec((any::<Index>(), any::<u8>()), 0..4), end in any::<Index>(), is_cut: bool,
    ) {
        let mut bytes = results.to_bytes();
        for (place, byte) in &damage {
            let place = place.index(bytes.len());
            bytes[place] = *byte;
        }
        if is_cut {
            bytes.truncate(end.index(bytes.len()));
        }
        match MergeResults::from_bytes(&bytes) {
            Ok(read) => {
                prop_assert!(read.agents.iter().all(|agent| is_place(&agent.root_from_agent)));
                prop_assert!(!damage.is_empty() || read.pair_verdicts == results.pair_verdicts);
            }
            Err(why) => prop_assert!(!why.is_empty() && (is_cut || !damage.is_empty())),
        }
    }

    /// Whatever was told before, agents stay where they can be, and each stands there once.
    #[test]
    fn overlaid_results_are_what_can_be(new in anything(), old in anything()) {
        let agents = |found: &MergeResults| found.agents.iter().map(|agent| agent.agent.clone()).collect::<BTreeSet<_>>();
        let all = new.clone().overlaid_by(&old);
        prop_assert_eq!(agents(&all), &agents(&new) | &agents(&old));
        prop_assert!(all.agents.len() <= old.agents.len() + agents(&new).len());
        prop_assert!(all.agents.iter().all(|agent| transform(&agent.root_from_agent).is_valid()));
    }
}
