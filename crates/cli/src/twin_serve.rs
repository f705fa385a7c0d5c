//! `scopeservo twin serve`: the simulated microscope for other programs.

use crate::args::TwinServeArgs;
use crate::driver_check::read_secret;
use crate::error::CliError;
use scopeservo_protocol::{Offer, listen, serve};
use scopeservo_scope::{Clock, SystemClock};
use scopeservo_twin::specimen::{FileSpecimen, Specimen, Tissue};
use scopeservo_twin::{Config, Twin};
use std::net::TcpListener;
use std::sync::Arc;

pub(crate) fn run(args: &TwinServeArgs) -> Result<bool, CliError> {
    let specimen: Arc<dyn Specimen> = match &args.specimen {
        Some(path) => Arc::new(FileSpecimen::open(path, args.um_per_px)?),
        None => Arc::new(Tissue::new(args.seed)),
    };
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let twin = Twin::new(Config::realistic(), specimen, args.seed, clock.clone())?;
    if !args.turned_deg.is_finite() {
        return Err(CliError::Usage(
            "--turned-deg must be a number of degrees".into(),
        ));
    }
    twin.centre_specimen(args.centre_um, args.turned_deg);
    let offer = Offer {
        name: "simulated microscope".into(),
        stage: Some(twin.stage()),
        camera: Some(twin.camera()),
        nosepiece: Some(twin.nosepiece()),
        clock,
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
