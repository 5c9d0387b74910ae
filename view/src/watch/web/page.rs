//! The page: the report's viewer on an empty scene, and what fills it as it comes.

use crate::report::cloud::Cloud;
use crate::report::page::{Template, fill, html_escaped};
use crate::report::scene::Scene as ReportScene;
use crate::script;
use crate::watch::chunk::SIGMA_RANGE;
use crate::watch::scene::{Agent, Scene};
use anyhow::Result;
use geometry::Pinhole;
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
        script!("../assets/warnings.js"),
        script!("../assets/panel.js"),
        script!("../assets/live.js"),
    ],
};

/// The camera of a map to which agents are yet to come.
const NOBODYS: Pinhole = Pinhole { width: 1, height: 1, fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0 };

/// What is behind a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// A run that takes commands.
    Live,
    /// A run that takes none: nobody looks after it.
    Service,
    /// Maps, and nobody who would take any.
    Maps,
    /// One who collects the maps of others.
    Station,
}

/// What the page's scripts start from.
#[derive(Serialize)]
struct Data {
    scene: ReportScene,
    cloud: Cloud,
    mode: Mode,
    /// Relative σ of codes 0 and 255.
    sigma: [f32; 2],
}

/// What a page knows of a scene before anything of it has come: whose keyframes will.
fn empty_map(agents: &[Agent]) -> Map {
    let agents = agents.iter().map(|agent| {
        let mut info = AgentInfo::new(agent.name.clone(), agent.camera);
        if agent.metric {
            info.set_metric();
        }
        info
    });
    let mut map = Map::new(NOBODYS);
    map.agents = (0..).map(AgentId).zip(agents).collect();
    map
}

/// The same, as the page's scripts read it.
pub fn scene_of(agents: &[Agent]) -> ReportScene {
    ReportScene::new(&empty_map(agents), &[], &[])
}

/// The page of a scene, which is still to come over the WebSocket.
pub fn render(title: &str, scene: &Scene, mode: Mode) -> Result<String> {
    let map = empty_map(&scene.agents);
    let data = Data {
        scene: ReportScene::new(&map, &[], &[]),
        cloud: Cloud::new(&map, &[], 0),
        mode,
        sigma: SIGMA_RANGE,
    };
    TEMPLATE.filled(title, &data)
}

/// What stands in place of the page while there is no run: why, by the text of `/health`. It looks again by itself.
pub fn without_run(health: &str) -> String {
    let health: serde_json::Value = serde_json::from_str(health).unwrap_or_default();
    let said = health["trouble"].as_array().into_iter().flatten().chain([&health["last_error"]]);
    let mut lines: Vec<String> = said.filter_map(|line| Some(html_escaped(line.as_str()?))).collect();
    lines.dedup();
    let state = html_escaped(health["state"].as_str().unwrap_or("starting"));
    let lines: String = lines.iter().map(|line| format!("<p>{line}</p>\n")).collect();
    fill(include_str!("../assets/without_run.html"), &[("state", &state), ("lines", &lines)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::watch::scene::tests::scene;

    #[test]
    fn the_page_needs_nothing_from_outside() {
        let page = render("yard <b>", &scene(1), Mode::Live).expect("it renders");
        assert!(page.contains("connect-src 'self'") && page.contains("yard &lt;b&gt;"));
        for outside in ["https://", "src=\"http", "href=\"http", "@import", "url("] {
            assert!(!page.contains(outside), "{outside}");
        }
    }

    #[test]
    fn without_a_run_the_page_says_why_there_is_none() {
        let health = r#"{"state":"waiting","trouble":["<b> is not there"],"last_error":"the disk is full"}"#;
        let page = without_run(health);
        for words in ["waiting", "&lt;b&gt; is not there", "the disk is full", "http-equiv=\"refresh\""] {
            assert!(page.contains(words), "{words}: {page}");
        }
        assert!(without_run("").contains("starting"));
    }

    #[test]
    fn a_page_can_be_asked_for_before_anybody_is_there() {
        let page = render("base", &Scene::default(), Mode::Station).expect("it renders");
        assert!(page.contains("\"agents\":[]") && page.contains("\"mode\":\"station\""));
    }
}
