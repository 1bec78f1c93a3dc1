//! The powder under the motion that an arm has made of a plan.

use powderline_executor::Config;
use powderline_shared::displacement::{Displacement, pose_at};
use powderline_shared::plan::PlanReader;
use powderline_shared::pose::Pose;
use powderline_shared::trajectory::{ANCHOR_TOLERANCE_M, ANCHOR_TOLERANCE_RAD, Sample, TrajectoryHeader};
use serde_json::Value;

use crate::programs::{Done, OPTIMISE, Place, bytes, run};

/// A plan of the tiny scene, and the poses at its ticks.
struct Planned {
    place: Place,
    plan: String,
    header: TrajectoryHeader,
    poses: Vec<Pose>,
}

impl Planned {
    fn new() -> Self {
        let place = Place::new();
        let folder = place.tiny_run("run", 0);
        let bytes = bytes(&folder, "skill.plan");
        let plan = PlanReader::new(&bytes).unwrap();
        let (start, lsb) = (plan.header().start_pose(), plan.header().lsb);
        let after = plan.setpoints().map(|setpoint| pose_at(&start, setpoint, lsb));
        let period_us = plan.header().control_period_us;
        Self {
            place,
            plan: format!("{folder}/skill.plan"),
            header: TrajectoryHeader { plan_hash: plan.content_hash(), period_us },
            poses: std::iter::once(start).chain(after).collect(),
        }
    }

    fn execute(&self, header: TrajectoryHeader, poses: &[Pose], more: &[&str]) -> Done {
        let mut text = format!("{header}\n");
        for (tick, pose) in (0..).zip(poses) {
            text += &format!("{}\n", Sample { tick, pose: *pose });
        }
        let file = self.place.write("executed.txt", text.as_bytes());
        run(OPTIMISE, &[&["simulate", "--plan", &self.plan, "--executed", &file], more].concat())
    }

    fn report(&self, poses: &[Pose]) -> Value {
        self.execute(self.header, poses, &["--json"]).json()
    }

    /// Every pose higher than planned.
    fn raised(&self, by_m: impl Fn(usize) -> f64) -> Vec<Pose> {
        let up = |tick| Displacement { translation_m: [0.0, 0.0, by_m(tick)], ..Displacement::default() };
        self.poses.iter().enumerate().map(|(tick, pose)| pose.displaced(&up(tick))).collect()
    }
}

fn loss(report: &Value) -> f64 {
    report["loss_m"].as_f64().unwrap()
}

fn arrives(report: &Value) -> u64 {
    report["census"]["target"].as_u64().unwrap()
}

#[test]
fn powder_goes_where_the_executed_motion_takes_it() {
    let planned = Planned::new();
    let steps = planned.poses.len() - 1;

    // As planned: what is predicted. The displacements between poses differ from the plan's by rounding in the last of 64
    // bits, which the powder's 32-bit numbers do not see.
    let exact = planned.report(&planned.poses);
    let predicted = &exact["plan"]["predicted"];
    assert_eq!(exact["indicator"], predicted["indicator"]);
    assert_eq!(exact["census"], predicted["census"]);
    assert!((loss(&exact) / loss(predicted) - 1.0).abs() < 1e-9, "{exact}");
    assert!(arrives(&exact) > 0, "{exact}");

    // A millimetre too high, from the tenth tick on: the bowl takes less.
    let raised = planned.report(&planned.raised(|tick| 1e-4 * tick.min(10) as f64));
    assert!((raised["executed"]["largest_deviation"]["mm"].as_f64().unwrap() - 1.0).abs() < 1e-9, "{raised}");
    assert!((loss(&raised) - loss(&exact)).abs() > 1e-3 * loss(&exact), "{raised} {exact}");
    assert_ne!(arrives(&raised), arrives(&exact));

    // An anchor that is a little off is where the arm begins; nobody puts it right.
    let beside = planned.report(&planned.raised(|_| 0.4e-3));
    assert!((beside["executed"]["end_deviation"]["mm"].as_f64().unwrap() - 0.4).abs() < 1e-9, "{beside}");
    assert_ne!(loss(&beside).to_bits(), loss(&exact).to_bits());

    // Stopped before it pours: nothing arrives, and what is in the bowl does not count as spilled.
    let stopped = planned.report(&planned.poses[..=steps / 2]);
    assert_eq!(stopped["executed"]["stopped_early"], true);
    assert_eq!(stopped["executed"]["simulated_steps"], steps);
    assert_eq!(arrives(&stopped), 0, "{stopped}");
    let said = planned.execute(planned.header, &planned.poses[..=steps / 2], &[]).succeeded();
    assert!(said.contains(&format!("it ends at tick {} of {steps}", steps / 2)), "{said}");

    let header = TrajectoryHeader { plan_hash: !planned.header.plan_hash, ..planned.header };
    planned.execute(header, &planned.poses, &[]).refused(2, "was executed from another plan");
}

#[test]
fn what_counts_as_the_plans_start_is_the_same_for_the_executor() {
    let Config { anchor_tolerance_m, anchor_tolerance_rad, .. } = Config::default();
    assert_eq!(
        [anchor_tolerance_m, anchor_tolerance_rad].map(f64::to_bits),
        [ANCHOR_TOLERANCE_M, ANCHOR_TOLERANCE_RAD].map(f64::to_bits)
    );
}
