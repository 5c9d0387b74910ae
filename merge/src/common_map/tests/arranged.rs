//! An arrangement and the own maps make the common map again, bit by bit.

use super::*;
use crate::common_map::Numbers;
use std::collections::BTreeMap;

/// What a manifest says of a common map, read back from its text.
fn arrangement(fused: &Fused) -> Arrangement {
    let placed = fused.agents.iter().map(|agent| Placed {
        map: usize::from(agent.0),
        agent: 0,
        root_from_agent: Numbers::of(&fused.component.agents[agent].root_from_agent),
    });
    let provenance = [("program".to_owned(), "loopbox".to_owned())].into();
    let arrangement = Arrangement::of(&fused.map, placed.collect(), provenance);
    let text = serde_json::to_string(&arrangement).unwrap();
    serde_json::from_str(&text).unwrap()
}

proptest! {
    #[test]
    fn it_is_assembled_bit_by_bit(seed in 0_u64..1000, optimise: bool, noise in 0.001..0.01) {
        let travellers = [0, 1, 2].map(|agent| Traveller::new(10 * seed + agent, 4));
        let maps: Vec<Map> = travellers.iter().map(|traveller| traveller.drifted_map(noise)).collect();
        let mut common = CommonMap::from_maps(&maps.iter().collect::<Vec<_>>()).unwrap().0;
        let travellers = [&travellers[0], &travellers[1], &travellers[2]];
        common.link(exact(&travellers, address(0, 3), address(1, 1)));
        common.link(exact(&travellers, address(1, 2), address(2, 0)));
        let fused = fused(&common, optimise);
        let arrangement = arrangement(&fused);
        let by_number: BTreeMap<usize, Map> = maps.into_iter().enumerate().collect();
        let mut expected = fused.map.clone();
        expected.merge_provenance.clone_from(&arrangement.provenance);
        let assembled = arrangement.assemble(&by_number).unwrap();
        prop_assert_eq!(format!("{:?}", assembled), format!("{expected:?}"));
        // What nobody moved by itself is not written down.
        prop_assert_eq!(arrangement.moved.is_empty(), !optimise);
        let others: BTreeMap<usize, Map> = by_number.into_iter().filter(|(number, _)| *number != 2).collect();
        prop_assert!(arrangement.assemble(&others).is_err());
    }
}
