//! `scopeservo serve`.

use super::InstrumentArgs;
use clap::Args;
use std::net::SocketAddr;

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo serve --demo                       the simulated microscope, with a slide to take out and put back
  scopeservo serve                              your instrument, as scopeservo.toml describes it
  scopeservo serve --listen 127.0.0.1:8080
  scopeservo serve --name scope-3.lab:443       behind a proxy with TLS on this computer, which has that name

Open the address that it prints in a browser on this computer. What is there first is a link that lets you in; on an instrument of your own
you then say who you are. Ctrl-C ends it: what moves is stopped.")]
pub(crate) struct ServeArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// The simulated microscope, in real time. Nothing of it outlives the program.
    #[arg(long, conflicts_with_all = ["config", "home", "immersion"])]
    pub(crate) demo: bool,
    /// Where to listen; a port of 0 takes any that is free. Only this computer can reach it.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7070")]
    pub(crate) listen: SocketAddr,
    /// Another name by which browsers may ask for it, that of a proxy on this computer; with its port where that is another.
    #[arg(long, value_name = "HOST[:PORT]")]
    pub(crate) name: Vec<String>,
}
