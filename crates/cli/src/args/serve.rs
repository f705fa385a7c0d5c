//! `scopeservo serve`.

use super::InstrumentArgs;
use clap::Args;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  scopeservo serve --demo                       the simulated microscope, with a slide to take out and put back
  scopeservo serve                              your instrument, as scopeservo.toml describes it
  scopeservo serve --listen 127.0.0.1:8080
  scopeservo serve --listen 0.0.0.0:7070 --tls  for other machines too, by TLS with a certificate that is made here
  scopeservo serve --listen 0.0.0.0:443 --tls-cert scope-3.pem --tls-key scope-3.key --name scope-3.lab
  scopeservo serve --name scope-3.lab:443       behind a proxy with TLS on this computer, which has that name

Open the address that it prints in a browser on this computer. What is there first is a link that lets you in; on an instrument of your own
you then say who you are. Ctrl-C ends it: what moves is stopped.")]
pub(crate) struct ServeArgs {
    #[command(flatten)]
    pub(crate) instrument: InstrumentArgs,
    /// The simulated microscope, in real time. Nothing of it outlives the program.
    #[arg(long, conflicts_with_all = ["config", "home", "immersion"])]
    pub(crate) demo: bool,
    /// Where to listen; a port of 0 takes any that is free. Only this computer can reach it, unless it is another address by TLS or for a proxy.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7070")]
    pub(crate) listen: SocketAddr,
    /// Another name by which browsers may ask for it: that of this computer in its network, or of a proxy; with its port where that is another.
    #[arg(long, value_name = "HOST[:PORT]")]
    pub(crate) name: Vec<String>,
    /// By TLS. Without --tls-cert the certificate is made here, once, and its fingerprint printed.
    #[arg(long)]
    pub(crate) tls: bool,
    /// By TLS with this certificate, in PEM form, and those that vouch for it after it.
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub(crate) tls_cert: Option<PathBuf>,
    /// The private key of the certificate, in PEM form.
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub(crate) tls_key: Option<PathBuf>,
    /// A proxy with TLS on another machine: without TLS of its own nobody else is heard there. What it says of whom it asks for counts.
    #[arg(long, value_name = "IP")]
    pub(crate) proxy: Vec<IpAddr>,
}
