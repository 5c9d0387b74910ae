//! The page: the report's viewer on an empty scene, and what fills it as it comes.

use crate::report::cloud::Cloud;
use crate::report::page::Template;
use crate::report::scene::Scene as ReportScene;
use crate::script;
use crate::watch::chunk::SIGMA_RANGE;
use crate::watch::scene::Scene;
use anyhow::{Context, Result};
use map::{AgentId, AgentInfo, Map};
use serde::Serialize;

const TEMPLATE: Template = Template {
    body: include_str!("../assets/live.html"),
    style: include_str!("../assets/live.css"),
    // The page and its WebSocket come from one place, and nothing from any other.
    policy: "; connect-src 'self'",
    scene: true,
    scripts: &[
        script!("../assets/store.js"),
        script!("../assets/decode.js"),
        script!("../assets/feed.js"),
        script!("../assets/lines.js"),
        script!("../assets/detail.js"),
        script!("../assets/view.js"),
        script!("../assets/near.js"),
        script!("../assets/panel.js"),
        script!("../assets/live.js"),
    ],
};

/// What the page's scripts start from.
#[derive(Serialize)]
struct Data {
    scene: ReportScene,
    cloud: Cloud,
    /// Whether there is a run behind it that takes commands.
    live: bool,
    /// Relative σ of codes 0 and 255.
    sigma: [f32; 2],
}

/// The page of a scene, which is still to come over the WebSocket.
pub fn render(title: &str, scene: &Scene, live: bool) -> Result<String> {
    let mut agents = scene.agents.iter().map(|agent| {
        let mut info = AgentInfo::new(agent.name.clone(), agent.camera);
        if agent.metric {
            info.set_metric();
        }
        info
    });
    let first = agents.next().context("there is no agent to show")?;
    let mut map = Map::of(first);
    map.agents.extend((1..).map(AgentId).zip(agents));
    let data = Data {
        scene: ReportScene::new(&map, &[], &[]),
        cloud: Cloud::new(&map, &[], 0),
        live,
        sigma: SIGMA_RANGE,
    };
    TEMPLATE.filled(title, &data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::watch::scene::tests::scene;

    #[test]
    fn the_page_needs_nothing_from_outside() {
        let page = render("yard <b>", &scene(1), true).expect("it renders");
        assert!(page.contains("connect-src 'self'") && page.contains("yard &lt;b&gt;"));
        for outside in ["https://", "src=\"http", "href=\"http", "@import", "url("] {
            assert!(!page.contains(outside), "{outside}");
        }
    }
}
