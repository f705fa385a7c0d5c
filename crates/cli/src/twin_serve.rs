//! `scopeservo twin serve`: the simulated microscope for other programs.

use crate::args::TwinServeArgs;
use crate::driver_check::read_secret;
use crate::error::CliError;
use scopeservo_protocol::{Offer, listen, serve};
use scopeservo_scope::{Clock, SystemClock};
use scopeservo_setup::{Config, TwinConfig};
use std::net::TcpListener;
use std::path::Path;
use std::sync::Arc;

pub(crate) fn run(args: &TwinServeArgs) -> Result<bool, CliError> {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::faster(args.speed));
    let twin = match &args.described_in {
        Some(path) => {
            let config = Config::read(path)?;
            let described = config.drivers.values().find_map(|d| d.twin.as_ref());
            let described = described.ok_or_else(|| {
                CliError::Usage(format!(
                    "{} describes no simulated microscope: give it a [drivers.NAME.twin]",
                    path.display()
                ))
            })?;
            described.build(|path| config.resolve(path), clock)?
        }
        None => {
            let told = TwinConfig {
                seed: args.seed,
                specimen: args.specimen.clone(),
                um_per_px: args.um_per_px,
                centre_um: args.centre_um,
                turned_deg: args.turned_deg,
                ..TwinConfig::default()
            };
            told.build(Path::to_path_buf, clock)?
        }
    };
    let offer = Offer {
        name: "simulated microscope".into(),
        devices: twin.devices(),
    };
    let Some(address) = &args.listen else {
        return serve(
            &offer,
            None,
            &mut std::io::stdin().lock(),
            std::io::stdout(),
        )
        .map(|()| true)
        .map_err(|e| CliError::Usage(format!("what came in is no request: {e}")));
    };
    let secret = args.secret_file.as_deref().map(read_secret).transpose()?;
    let failed = |e: std::io::Error| CliError::Usage(format!("cannot listen on {address}: {e}"));
    let listener = TcpListener::bind(address).map_err(failed)?;
    let at = listener.local_addr().map_err(failed)?;
    tell!("scopeservo: the simulated microscope listens on {at}; Ctrl-C ends it");
    let told = |what: &str| tell!("scopeservo: a client was disconnected: {what}");
    listen(&listener, &offer, secret.as_ref(), &told).map_err(failed)?;
    Ok(true)
}
