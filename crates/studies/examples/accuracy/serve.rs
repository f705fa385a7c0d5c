//! The renderer as a server on stdin and stdout.

use scopeservo_studies::accuracy::degrade::Condition;
use scopeservo_studies::accuracy::scenes::{PairId, SceneId, Slides, set_name};
use scopeservo_studies::warp::SIZE;
use serde_json::json;
use std::io::{BufRead, Write, stdin, stdout};

pub(crate) fn run(mut slides: Slides, seed: u64) -> Result<(), Box<dyn std::error::Error>> {
    let mut out = stdout().lock();
    writeln!(out, "{}", json!({ "set": set_name(seed), "size": SIZE }))?;
    out.flush()?;
    for line in stdin().lock().lines() {
        let line = line?;
        let id = SceneId::parse(line.trim()).ok_or_else(|| format!("no scene is called {line}"))?;
        let scene = slides.scene(id, seed)?;
        let views = Condition::EACH.map(|condition| (condition, scene.view(condition).1));
        let pairs: Vec<_> = views
            .iter()
            .map(|(condition, frame)| {
                let pair = PairId {
                    scene: id,
                    condition: *condition,
                };
                json!({ "pair": pair.to_string(), "frames": scene.checksum(frame) })
            })
            .collect();
        let header = json!({
            "scene": id.to_string(),
            "specimen": id.specimen(),
            "target_from_view": scene.target_from_view,
            "pairs": pairs,
        });
        writeln!(out, "{header}")?;
        out.write_all(&scene.target)?;
        for (_, frame) in &views {
            out.write_all(frame)?;
        }
        out.flush()?;
    }
    Ok(())
}
