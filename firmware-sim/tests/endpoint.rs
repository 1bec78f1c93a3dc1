//! The controller with its wire: frames in, frames out.

use nalgebra::Vector3;
use powderline_firmware_sim::controller::{ArmConfig, Controller};
use powderline_firmware_sim::endpoint::Endpoint;
use powderline_shared::limits::Limits;
use powderline_shared::pose::Pose;
use powderline_shared::wire::Context;
use powderline_shared::wire::codec::{Encoder, FromArmDecoder};
use powderline_shared::wire::frame::Dialect;
use powderline_shared::wire::message::{FromArm, OpenRequest, PROTOCOL_VERSION, ToArm};
use powderline_shared::wire::state::{Command, State};

/// An arm, and clients that each know their own session only.
struct Bench {
    arm: Endpoint,
    dialect: Dialect,
}

/// One session's end of the wire.
struct Client {
    context: Context,
    encoder: Encoder,
    decoder: FromArmDecoder,
    heard: Vec<FromArm>,
    /// Frames that were not for it, or wrong.
    rejected: usize,
}

impl Bench {
    fn new(dialect: Dialect) -> Self {
        let start = Pose { position_m: Vector3::new(0.3, 0.1, 0.2), ..Pose::identity() };
        Self { arm: Endpoint::new(Controller::new(ArmConfig::ideal(start)), dialect), dialect }
    }

    /// What the arm makes of a message, as the client reads it.
    fn tell(&mut self, client: &mut Client, message: &ToArm) {
        for frame in client.encoder.to_arm(&client.context, message) {
            self.arm.handle_frame(0, &frame);
        }
        client.heard.clear();
        client.rejected = 0;
        while let Some(frame) = self.arm.poll(0) {
            match client.decoder.handle_frame(&frame) {
                Ok(messages) => client.heard.extend(messages),
                Err(_) => client.rejected += 1,
            }
        }
    }

    fn open(&mut self, session: u16) -> Client {
        let mut client = Client {
            context: Context::NONE,
            encoder: Encoder::new(self.dialect),
            decoder: FromArmDecoder::new(self.dialect),
            heard: Vec::new(),
            rejected: 0,
        };
        let request = OpenRequest {
            version: PROTOCOL_VERSION,
            session,
            plan_hash: 1,
            period_us: 10_000,
            end_tick: 100,
            lsb: self.dialect.lsb(),
            limits: Limits {
                // So that classic CAN's counts, which are ten times as large, are fine enough.
                linear_jerk_m_s3: 4_000.0,
                ..ArmConfig::ideal(Pose::identity()).limits
            },
            start_level: 4,
            reset_nonce: 0,
        };
        self.tell(&mut client, &ToArm::Open(request));
        let nonce = client.heard.iter().find_map(|message| match message {
            FromArm::Opened { session: of, nonce, .. } if *of == session => Some(*nonce),
            _ => None,
        });
        client.context = Context::sealed(&request, nonce.unwrap());
        client.decoder.set_context(client.context);
        client
    }

    fn command(&mut self, client: &mut Client, command: Command) {
        let session = client.context.session;
        self.tell(client, &ToArm::Control { session, command });
    }

    fn enable(&mut self, client: &mut Client) {
        let up = [Command::Shutdown, Command::SwitchOn, Command::EnableOperation];
        up.into_iter().for_each(|command| self.command(client, command));
        assert_eq!(self.arm.controller().state(), State::OperationEnabled);
    }
}

/// How often a session's own status says that it is over, and the arm stands.
fn farewells(client: &Client) -> usize {
    let is_farewell = |message: &&FromArm| {
        matches!(message, FromArm::Status(status) if status.session == client.context.session
            && status.state == State::ReadyToSwitchOn && status.standstill)
    };
    client.heard.iter().filter(is_farewell).count()
}

#[test]
fn whoever_asks_a_session_that_is_over_hears_how_it_ended_whatever_session_is_open() {
    for dialect in [Dialect::Classic, Dialect::Fd] {
        let mut bench = Bench::new(dialect);
        let mut first = bench.open(7);
        bench.enable(&mut first);
        bench.command(&mut first, Command::Shutdown);
        assert_eq!((farewells(&first), bench.arm.controller().context()), (1, Context::NONE));
        // Nobody is in session; then another is.
        bench.command(&mut first, Command::Shutdown);
        assert_eq!((farewells(&first), first.rejected), (1, 0), "{dialect:?}");
        let second = bench.open(8);
        bench.command(&mut first, Command::Shutdown);
        assert_eq!((farewells(&first), first.rejected), (1, 0), "{dialect:?}");
        assert_eq!(bench.arm.controller().context(), second.context);
    }
}
