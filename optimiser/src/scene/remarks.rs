//! What is allowed in a scene but worth knowing.

use super::figures::about;
use super::solid::Hull;
use super::tool_body::PlacedTool;
use super::{Container, Scene};

/// Gap between expectation and geometry that is worth a remark, in cells.
const REMARKABLE_CELLS: f64 = 0.25;

impl Scene {
    /// Sentences about a valid scene that may hide a mistake: corners of the skill's range in which the tool
    /// would pass through a container, and a start height at odds with the approach.
    pub fn remarks(&self) -> Vec<String> {
        [self.remark_approach(), self.remark_handle(), self.remark_transport()]
            .into_iter()
            .flatten()
            .collect()
    }

    fn remark_approach(&self) -> Option<String> {
        let start = PlacedTool::new(self, self.tool.start_position_m, self.tool.start_pitch_deg);
        let lowest_m = -start.body_reach([0.0, 0.0, -1.0]) - self.skill.approach_m;
        let above_m = lowest_m - self.powder.fill_max_m[2];
        (above_m.abs() > REMARKABLE_CELLS * self.domain.cell_m).then(|| {
            format!(
                "after skill.approach_m the tool's lowest point is {} mm {} the powder's surface, which depths are \
                 measured from",
                about(1e3 * above_m.abs(), 3),
                if above_m > 0.0 { "above" } else { "below" }
            )
        })
    }

    fn remark_handle(&self) -> Option<String> {
        let source = self.source();
        let solids = source.pieces();
        let hits = self.scoop_poses().any(|(origin, pitch_deg)| {
            let tool = PlacedTool::new(self, origin, pitch_deg);
            solids.iter().any(|solid| !tool.handle_clears(solid))
        });
        hits.then(|| {
            format!(
                "in some corner of the skill's range the handle passes through container {:?} while scooping",
                source.name
            )
        })
    }

    fn remark_transport(&self) -> Option<String> {
        let solids: Vec<(&Container, Vec<Hull>)> =
            self.container.iter().map(|container| (container, container.pieces())).collect();
        let hit = self.lowest_transport_poses().find_map(|(origin, pitch_deg)| {
            let tool = PlacedTool::new(self, origin, pitch_deg);
            solids.iter().find(|(_, pieces)| pieces.iter().any(|piece| !tool.body_clears(piece)))
        });
        hit.map(|(container, _)| {
            format!(
                "at the lowest lift after the deepest scoop the tool passes through container {:?}",
                container.name
            )
        })
    }
}
