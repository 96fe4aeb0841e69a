//! Pictures of shapes to which a dictionary is applied.

use axum::response::Response;

use crate::api::problem::Problem;
use crate::api::respond::{compute, picture};
use crate::api::v1::dictionaries::coding::Received;
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::dictionaries::coding::Asked;
use crate::service::dictionaries::pictures::MAX_SHAPES;
use crate::service::dictionaries::ready::Ready;
use crate::wire::fault::Fault;
use crate::wire::picture::PictureFile;

/// Answers a request about shapes with a picture: checks its settings, resolves its shapes, predicts the work and draws.
/// `settings` as for answers in JSON; the number of numbers has no meaning here.
pub(in crate::api::v1) async fn draw_dictionary<R, T: Send + 'static>(
    app: App,
    received: Received<R>,
    file: PictureFile,
    settings: impl FnOnce(R, &Ready, &mut Vec<Fault>) -> Option<(T, usize)>,
    draw: impl FnOnce(&App, &Ready, Asked, T) -> Result<Drawing, ServiceError> + Send + 'static,
) -> Result<Response, Problem> {
    let Received { ready, request, shapes, mut errors, form, places } = received;
    let settings = settings(request, &ready, &mut errors).map(|(settings, _)| settings);
    let asked = shapes.ask(&app, &ready, settings, errors, form.on_error).await;
    let (settings, asked) = asked.map_err(|error| places.of(error))?;
    let drawn = requests::draw(Counts::for_space(&ready.setup.space, 0, &app.limits), 2 * MAX_SHAPES);
    let work = asked.work(&ready, 0, &app.limits) + drawn + requests::picture(&file);
    compute(app.weighing(work), move |app| {
        let drawing = draw(app, &ready, asked, settings).map_err(|error| places.of(error))?;
        picture(&drawing, &file)
    })
    .await
}
