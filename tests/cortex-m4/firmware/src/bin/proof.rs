//! Never run: it only has to link, with `prove-no-panic`. The address of each function leaves the optimiser's sight, so
//! each is there for whatever arguments its types allow.
#![no_std]
#![no_main]

use core::hint::black_box;

use cortex_m_rt::entry;
use heapless::Vec;
use nalgebra::{Matrix6, UnitQuaternion, Vector3};
use powderline_cortex_m4::report::fail;
use powderline_executor::{Action, Config, Endpoint, Executor, FrameAction};
use powderline_shared::arm::inverse::Posture;
use powderline_shared::arm::links::SingularityMargins;
use powderline_shared::arm::{ArmError, ArmKind, ArmModel, Joints};
use powderline_shared::displacement::{
    Displacement, Lsb, Quantiser, Setpoint, SetpointError, StepCounts, displacement_between, pose_at,
};
use powderline_shared::limits::{LimitChecker, Limits, LimitsError, Motion, PeakUse, Violation};
use powderline_shared::plan::{PlanError, PlanReader, Setpoints, Steps};
use powderline_shared::pose::{Pose, exp_so3, log_so3, renormalised};
use powderline_shared::sieve::Sieve;
use powderline_shared::wire::Context;
use powderline_shared::wire::auth::{KEY_BYTES, Key, Proof, SessionKey, Tag, TagWatch};
use powderline_shared::wire::codec::{Decoded, Encoder, Frames, FromArmDecoder, Rejected, ToArmDecoder};
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::message::{FromArm, OpenRequest, Status, ToArm};
use powderline_shared::wire::serial::{LineError, LineReader, MAX_LINE_BYTES, to_line};
use powderline_shared::wire::state::{Event, State, Transition, transition};

type Rotation = UnitQuaternion<f64>;
type Reader = PlanReader<'static>;
type Player = Executor<'static>;
type Ends = Endpoint<'static>;

#[entry]
fn main() -> ! {
    poses();
    arm();
    setpoints();
    limits();
    plans();
    wire();
    executor();
    powderline_cortex_m4::planted_panic();
    fail("this program is not meant to run")
}

fn poses() {
    black_box(exp_so3 as fn(&Vector3<f64>) -> Rotation);
    black_box(log_so3 as fn(&Rotation) -> Vector3<f64>);
    black_box(renormalised as fn(Rotation) -> Rotation);
    black_box(Pose::displaced as fn(&Pose, &Displacement) -> Pose);
    black_box(Pose::displacement_to as fn(&Pose, &Pose) -> Displacement);
    black_box(Pose::world_from_tool as fn(&Pose, &Vector3<f64>) -> Vector3<f64>);
    black_box(Pose::tool_from_world as fn(&Pose, &Vector3<f64>) -> Vector3<f64>);
    black_box(Pose::then as fn(&Pose, &Pose) -> Pose);
    black_box(Pose::inverse as fn(&Pose) -> Pose);
}

fn arm() {
    type Found = Result<Joints, ArmError>;
    type Checked = Result<(), ArmError>;
    black_box(ArmModel::world_from_tool as fn(&ArmModel, &Joints) -> Pose);
    black_box(ArmModel::jacobian as fn(&ArmModel, &Joints) -> Matrix6<f64>);
    black_box(ArmModel::joints_near as fn(&ArmModel, &Joints, &Pose) -> Found);
    black_box(ArmModel::joints_after as fn(&ArmModel, &Joints, &Pose, f64) -> Found);
    black_box(ArmModel::check_joints as fn(&ArmModel, &Joints) -> Checked);
    black_box(ArmModel::check_speed as fn(&ArmModel, &Joints, &Joints, f64) -> Checked);
    black_box(Posture::of as fn(ArmKind, &Joints) -> Posture);
    black_box(SingularityMargins::least as fn(&SingularityMargins) -> (u8, f64));
}

fn setpoints() {
    type Made = Result<Setpoint, SetpointError>;
    type Step = Result<StepCounts, SetpointError>;
    black_box(pose_at as fn(&Pose, Setpoint, Lsb) -> Pose);
    black_box(displacement_between as fn(Setpoint, Setpoint, Lsb) -> Displacement);
    black_box(Setpoint::from_cumulative as fn(u32, &Displacement, Lsb) -> Made);
    black_box(Setpoint::stepped as fn(Setpoint, StepCounts, Lsb) -> Made);
    black_box(Setpoint::step_from as fn(Setpoint, Setpoint, Lsb) -> Step);
    black_box(Setpoint::rescaled as fn(Setpoint, Lsb, Lsb) -> Made);
    black_box(Setpoint::validate as fn(Setpoint, Lsb) -> Result<(), SetpointError>);
    black_box(
        Quantiser::push as fn(&mut Quantiser, &Displacement) -> Result<(Setpoint, StepCounts), SetpointError>,
    );
}

fn limits() {
    black_box(Limits::validate as fn(&Limits) -> Result<(), LimitsError>);
    black_box(Limits::check_resolution as fn(&Limits, Lsb, u32) -> Result<(), LimitsError>);
    black_box(Limits::noise_share as fn(&Limits, Lsb, u32) -> f64);
    black_box(Limits::tighter as fn(&Limits, &Limits) -> Limits);
    black_box(Motion::moved_to as fn(&Motion, Pose, u32) -> Motion);
    black_box(LimitChecker::new as fn(Limits, Lsb, u32, Pose) -> LimitChecker);
    black_box(LimitChecker::check as fn(&mut LimitChecker, Pose) -> Result<Motion, Violation>);
    black_box(LimitChecker::finish as fn(&mut LimitChecker) -> Result<(), Violation>);
    black_box(Sieve::new as fn(&Pose, &Limits, Lsb, u32) -> Sieve);
    black_box(Sieve::after as fn(&Sieve, Setpoint) -> (Sieve, bool));
    black_box(Sieve::may_end as fn(&Sieve) -> bool);
    black_box(Sieve::peak_use as fn(&Sieve) -> PeakUse);
}

fn plans() {
    black_box(Reader::new as fn(&'static [u8]) -> Result<Reader, PlanError>);
    black_box(Reader::check_limits as fn(&Reader) -> Result<PeakUse, Violation>);
    black_box(Reader::end_pose as fn(&Reader) -> Pose);
    black_box(<Steps<'static> as Iterator>::next as fn(&mut Steps<'static>) -> Option<StepCounts>);
    black_box(<Setpoints<'static> as Iterator>::next as fn(&mut Setpoints<'static>) -> Option<Setpoint>);
}

fn wire() {
    type Heard<M> = Result<Decoded<M>, Rejected>;
    black_box(Encoder::to_arm as fn(&mut Encoder, &Context, &ToArm) -> Frames);
    black_box(Encoder::from_arm as fn(&Encoder, &Context, &FromArm) -> Frames);
    black_box(<Frames as Iterator>::next as fn(&mut Frames) -> Option<Frame>);
    black_box(ToArmDecoder::new as fn(Dialect) -> ToArmDecoder);
    black_box(ToArmDecoder::set_context as fn(&mut ToArmDecoder, Context));
    black_box(ToArmDecoder::handle_frame as fn(&mut ToArmDecoder, &Frame) -> Heard<ToArm>);
    black_box(FromArmDecoder::new as fn(Dialect) -> FromArmDecoder);
    black_box(FromArmDecoder::set_context as fn(&mut FromArmDecoder, Context));
    black_box(FromArmDecoder::expect as fn(&mut FromArmDecoder, Setpoint));
    black_box(FromArmDecoder::handle_frame as fn(&mut FromArmDecoder, &Frame) -> Heard<FromArm>);
    type Proven = fn(&Key, &OpenRequest, u64) -> Proof;
    type Agreed<T> = fn(&Key, &OpenRequest, u64, u32) -> T;
    black_box(Key::new as fn(&[u8; KEY_BYTES]) -> Key);
    black_box(Key::prove as Proven);
    black_box(Key::proves as fn(&Key, &OpenRequest, &Proof) -> bool);
    black_box(Key::answer as Agreed<Tag>);
    black_box(Key::session as Agreed<SessionKey>);
    black_box(TagWatch::is_too_many as fn(&mut TagWatch, Dialect, &Context, &Rejected) -> bool);
    black_box(to_line as fn(&Frame) -> Vec<u8, MAX_LINE_BYTES>);
    black_box(LineReader::push as fn(&mut LineReader, u8) -> Option<Result<Frame, LineError>>);
}

fn executor() {
    black_box(transition as fn(State, Event) -> Option<Transition>);
    black_box(Status::credit_until as fn(&Status) -> u32);
    black_box(Player::new as fn(u64, &Reader, Config) -> Player);
    black_box(Player::handle_message as fn(&mut Player, u64, &FromArm));
    black_box(Player::handle_stop as fn(&mut Player, u64));
    black_box(Player::poll as fn(&mut Player, u64) -> Action);
    black_box(Player::poll_at as fn(&Player) -> Option<u64>);
    black_box(Player::violation as fn(&Player) -> Option<Violation>);
    black_box(Player::peak_use as fn(&Player) -> PeakUse);
    black_box(Ends::new as fn(u64, &Reader, Dialect, Config) -> Ends);
    black_box(Ends::handle_frame as fn(&mut Ends, u64, &Frame) -> Result<(), Rejected>);
    black_box(Ends::poll as fn(&mut Ends, u64) -> FrameAction);
}
