//! The process that reads parts and sums them.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use arrow_flight::flight_service_server::FlightServiceServer;
use ballista_core::config::TaskSchedulingPolicy;
use ballista_core::error::BallistaError;
use ballista_core::serde::protobuf::executor_status::Status;
use ballista_core::serde::protobuf::scheduler_grpc_client::SchedulerGrpcClient;
use ballista_core::serde::protobuf::{ExecutorStatus, GetJobStatusParams, HeartBeatParams};
use ballista_executor::ArrowFlightServerProvider;
use ballista_executor::executor_process::{
    ExecutorProcessConfig, start_executor_process, structure_executor_metadata,
};
use ballista_executor::executor_server::TERMINATING;
use ballista_executor::flight_service::BallistaFlightService;
use tonic::Code;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Endpoint;

use super::codec::Codec;
use super::metrics::{self, Process};
use super::network::{Address, MAX_MESSAGE_BYTES, Network, SameBuild, text};
use crate::EngineError;
use crate::objects::Objects;

/// Pause between attempts to reach the scheduler, and between signs of life.
const PAUSE: Duration = Duration::from_secs(1);

/// An executor.
#[derive(Debug, Clone)]
pub struct Executor {
    /// The scheduler.
    pub scheduler: Address,
    /// Where clients fetch results, as they reach it.
    pub listen: Address,
    /// Number of tasks at a time.
    pub tasks: usize,
    /// Memory of the operators of DataFusion, in bytes.
    pub memory_bytes: usize,
    /// Folder of results until they are fetched.
    pub folder: PathBuf,
    /// Where it answers `GET /metrics`, if anywhere.
    pub metrics: Option<Address>,
}

impl Executor {
    /// Works until the process is told to end; waits for a scheduler that is not there.
    ///
    /// # Errors
    /// A scheduler of another build, or that refuses the certificate; addresses of other machines without certificates.
    pub async fn work(self, objects: Objects, network: &Network) -> Result<(), EngineError> {
        network.check("--scheduler", &self.scheduler)?;
        network.check("--listen", &self.listen)?;
        if let Some(address) = &self.metrics {
            metrics::serve(Process::Executor(objects.counters().clone()), address).await?;
        }
        self.greet(network).await?;
        let host = self.listen.host.trim_matches(['[', ']']);
        let mut found = tokio::net::lookup_host((host, self.listen.port)).await?;
        let unknown =
            || EngineError::refused("--listen", format!("expected a name with an address, got '{host}'"));
        let bind_host = found.next().ok_or_else(unknown)?.ip();
        let folder = self.folder.to_str();
        let folder = folder.ok_or_else(|| EngineError::refused("--folder", "expected a path in UTF-8"))?;
        let config = ExecutorProcessConfig {
            bind_host: if bind_host.is_ipv6() { format!("[{bind_host}]") } else { bind_host.to_string() },
            external_host: Some(self.listen.host.clone()),
            port: self.listen.port,
            scheduler_host: self.scheduler.host.clone(),
            scheduler_port: self.scheduler.port,
            vcores: self.tasks,
            task_scheduling_policy: TaskSchedulingPolicy::PullStaged,
            work_dir: Some(folder.into()),
            job_data_ttl_seconds: 3600,
            job_data_clean_up_interval_seconds: 300,
            grpc_max_decoding_message_size: MAX_MESSAGE_BYTES as u32,
            grpc_max_encoding_message_size: MAX_MESSAGE_BYTES as u32,
            memory_pool_size: Some(self.memory_bytes as u64),
            override_physical_codec: Some(Arc::new(Codec::reading(objects))),
            override_arrow_flight_service: Some(results(network.clone())),
            override_create_grpc_client_endpoint: Some(network.endpoints()),
            ..ExecutorProcessConfig::default()
        };
        let config = Arc::new(config);
        let signs = tokio::spawn(give_signs(network.endpoint(&self.scheduler)?, config.clone()));
        let worked = start_executor_process(config).await;
        signs.abort();
        worked.map_err(|error| EngineError::refused("executor", text(&error)))
    }

    /// Asks the scheduler for a job that does not exist: an executor that is refused ends now, and not while it works.
    async fn greet(&self, network: &Network) -> Result<(), EngineError> {
        let endpoint = network.endpoint(&self.scheduler)?;
        loop {
            if let Ok(channel) = endpoint.connect().await {
                let asked = GetJobStatusParams { job_id: "none".into() };
                match SchedulerGrpcClient::new(channel).get_job_status(asked).await {
                    Err(status) if status.code() == Code::FailedPrecondition => {
                        return Err(EngineError::refused("--scheduler", status.message()));
                    }
                    Err(status) if status.code() == Code::Unavailable || status.code() == Code::Unknown => {}
                    _ => return Ok(()),
                }
            }
            tokio::time::sleep(PAUSE).await;
        }
    }
}

/// Tells the scheduler every second that this executor lives. Its requests for tasks tell it too, but those of a busy executor come every
/// 5 s: a dead one would be missed as late.
async fn give_signs(scheduler: Endpoint, config: Arc<ExecutorProcessConfig>) {
    let mut scheduler = SchedulerGrpcClient::new(scheduler.connect_lazy());
    let metadata = structure_executor_metadata(&config, config.vcores as u32);
    while !TERMINATING.load(Ordering::Acquire) {
        tokio::time::sleep(PAUSE).await;
        let sign = HeartBeatParams {
            executor_id: config.executor_id.clone(),
            metrics: Vec::new(),
            status: Some(ExecutorStatus { status: Some(Status::Active(String::new())) }),
            metadata: Some(metadata.clone()),
        };
        // A scheduler that is not there finds this executor when it is.
        let _ = scheduler.heart_beat_from_executor(sign).await;
    }
}

/// The server of results: that of Ballista, with certificates and the check of builds.
fn results(network: Network) -> Arc<ArrowFlightServerProvider> {
    Arc::new(move |folder, address, mut stop, _| {
        let server = network.server();
        tokio::spawn(async move {
            let service = FlightServiceServer::new(BallistaFlightService::new(folder))
                .max_decoding_message_size(MAX_MESSAGE_BYTES)
                .max_encoding_message_size(MAX_MESSAGE_BYTES);
            let mut server = server.map_err(|error| BallistaError::General(error.to_string()))?;
            let served = server
                .add_service(InterceptedService::new(service, SameBuild))
                .serve_with_shutdown(address, stop.recv());
            served.await.map_err(BallistaError::TonicError)
        })
    })
}
