//! Submits the jobs of a pass, and merges the results.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

use ballista_core::client::BallistaClient;
use ballista_core::error::BallistaError;
use ballista_core::extension::BallistaConfigGrpcEndpoint;
use ballista_core::serde::protobuf::execute_query_params::Query;
use ballista_core::serde::protobuf::job_status::Status;
use ballista_core::serde::protobuf::scheduler_grpc_client::SchedulerGrpcClient;
use ballista_core::serde::protobuf::{
    CancelJobParams, ExecuteQueryParams, GetJobStatusResult, JobStatus, PartitionLocation,
};
use ballista_core::version::insert_version_header;
use datafusion_common::{DataFusionError, Result};
use datafusion_datasource::memory::MemorySourceConfig;
use datafusion_physical_plan::ExecutionPlan;
use datafusion_proto::physical_plan::AsExecutionPlan;
use datafusion_proto::protobuf::PhysicalPlanNode;
use futures_util::future::BoxFuture;
use futures_util::{FutureExt, StreamExt, TryStreamExt};
use shapelex_analysis::accumulate::FAN_IN;
use tonic::transport::Channel;
use tonic::{Code, Request, Streaming};

use super::codec::Codec;
use super::network::{Address, MAX_MESSAGE_BYTES, Network, text};
use crate::EngineError;
use crate::pass::division::{Division, Unit};
use crate::pass::engine::Took;
use crate::pass::fold::FoldExec;
use crate::pass::rows;
use crate::pass::subject::{Runner, Subject};
use crate::pass::sum::{Parts, SumExec};
use crate::pass::task::{Task, own_error};
use crate::pass::work::Work;

/// Jobs that are submitted at the same time: executors have work while the results of a job are fetched.
const JOBS: usize = 2;

/// Maximum pause before a job is submitted again.
const MAX_PAUSE: Duration = Duration::from_secs(8);

/// A cluster, as a client uses it.
#[derive(Clone)]
pub struct Client {
    /// The scheduler.
    pub scheduler: Address,
    /// Certificates.
    pub network: Network,
    /// Duration after which a job is cancelled and submitted again.
    pub patience: Duration,
    /// Number of times that a job is submitted again, one after the other, without any result.
    pub attempts: u32,
    /// Number of groups of parts from which on a task sums a whole group: [`MIN_GROUPS`](crate::pass::division::MIN_GROUPS) unless there is a reason.
    pub min_groups: usize,
    /// Told the id of each job at the scheduler.
    pub submitted: fn(&str),
    /// Told why a job is submitted again.
    pub notice: fn(&str),
}

impl fmt::Debug for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the scheduler {}:{}", self.scheduler.host, self.scheduler.port)
    }
}

impl Runner for Client {
    /// Cost: one read of all parts by executors; one sum for each part or, from 16 groups of parts on, for each group over the network.
    /// Memory: the sums of two jobs, 64 each.
    fn run<'a>(
        &'a self,
        subject: Subject,
        work: &'a Work,
    ) -> BoxFuture<'a, Result<(Vec<u8>, Took), EngineError>> {
        self.compute(subject, work).boxed()
    }
}

/// Why a job has not all results.
enum Failure {
    /// The pass cannot succeed.
    Final(EngineError),
    /// Another attempt may succeed: a process died, or did not answer in time.
    Passing(String),
}

fn passing(error: &dyn std::error::Error) -> Failure {
    Failure::Passing(text(error))
}

impl From<DataFusionError> for Failure {
    fn from(error: DataFusionError) -> Self {
        Self::Final(error.into())
    }
}

impl Client {
    async fn compute(&self, subject: Subject, work: &Work) -> Result<(Vec<u8>, Took), EngineError> {
        self.network.check("--scheduler", &self.scheduler)?;
        let division = Division::new(work.units(subject.revision.parts()), self.min_groups);
        let (units, task) = (division.units(), Task::new(subject, work.clone()));
        let (task, resubmitted) = (Arc::new(task), AtomicUsize::new(0));
        let jobs: Vec<Vec<Unit>> = units.chunks(FAN_IN).map(<[Unit]>::to_vec).collect();
        let took = Took { jobs: jobs.len(), ..Took::default() };
        let node = |job| self.node(&task, division, job, &resubmitted);
        let nodes: Vec<Vec<u8>> =
            futures_util::stream::iter(jobs).map(node).buffered(JOBS).try_collect().await?;
        let sum = tokio::task::spawn_blocking(move || task.fold(nodes)).await;
        let sum = sum.map_err(|error| EngineError::refused("runtime", error.to_string()))??;
        let sum = sum.ok_or_else(|| EngineError::refused("revision", "expected a part, got none"))?;
        Ok((sum, Took { resubmitted: resubmitted.into_inner(), ..took }))
    }

    /// The sum of at most 64 units, submitted until there is a result of each.
    async fn node(
        &self,
        task: &Arc<Task>,
        division: Division,
        units: Vec<Unit>,
        resubmitted: &AtomicUsize,
    ) -> Result<Vec<u8>, EngineError> {
        let mut sums = BTreeMap::new();
        let (mut attempt, mut pause) = (0, Duration::from_millis(250));
        loop {
            let missing: Vec<Unit> =
                units.iter().filter(|unit| !sums.contains_key(&unit.number)).cloned().collect();
            if missing.is_empty() {
                break;
            }
            let before = sums.len();
            match self.job(task, division, &missing, &mut sums).await {
                Ok(()) => continue,
                Err(Failure::Final(error)) => return Err(error),
                Err(Failure::Passing(reason)) => {
                    if sums.len() > before {
                        (attempt, pause) = (0, Duration::from_millis(250));
                    }
                    attempt += 1;
                    if attempt > self.attempts {
                        let detail = format!(
                            "expected the results of a job, got none in {attempt} attempts: {reason}"
                        );
                        return Err(EngineError::refused(format!("{self:?}"), detail));
                    }
                    (self.notice)(&format!("a job of {} tasks is submitted again: {reason}", missing.len()));
                    resubmitted.fetch_add(1, Ordering::Relaxed);
                }
            }
            tokio::time::sleep(pause).await;
            pause = (2 * pause).min(MAX_PAUSE);
        }
        task.count(units.iter().map(|unit| unit.parts.len()).sum());
        let (task, mut sums) = (task.clone(), sums.into_values().collect::<Vec<_>>());
        if division.parts == 1 {
            return sums.pop().ok_or_else(|| EngineError::refused("revision", "expected a part, got none"));
        }
        let merge = move || task.merge(&sums.iter().map(Vec::as_slice).collect::<Vec<_>>());
        let merged = tokio::task::spawn_blocking(merge).await;
        merged.map_err(|error| EngineError::refused("runtime", error.to_string()))?
    }

    /// Submits a job, waits for its end, and fetches its results.
    async fn job(
        &self,
        task: &Arc<Task>,
        division: Division,
        units: &[Unit],
        sums: &mut BTreeMap<usize, Vec<u8>>,
    ) -> Result<(), Failure> {
        let endpoint = self.network.endpoint(&self.scheduler).map_err(Failure::Final)?;
        let channel = endpoint.connect().await.map_err(|error| passing(&error))?;
        let mut scheduler = SchedulerGrpcClient::new(channel)
            .max_decoding_message_size(MAX_MESSAGE_BYTES)
            .max_encoding_message_size(MAX_MESSAGE_BYTES);
        let events = scheduler.execute_query_push(request(plan(task, division, units)?)?).await;
        let mut events = events.map_err(|status| refused(&status))?.into_inner();
        let mut job = None;
        match tokio::time::timeout(self.patience, self.ended(&mut events, &mut job)).await {
            Ok(locations) => self.fetch(locations?, units, sums).await,
            Err(_) => {
                cancel(&mut scheduler, job).await;
                Err(Failure::Passing(format!("not done in {} s", self.patience.as_secs())))
            }
        }
    }

    /// Waits for the end of a job: where its results are. Notes its id in `job`.
    async fn ended(
        &self,
        events: &mut Streaming<GetJobStatusResult>,
        job: &mut Option<String>,
    ) -> Result<Vec<PartitionLocation>, Failure> {
        while let Some(event) = events.message().await.map_err(|status| refused(&status))? {
            let Some(JobStatus { job_id, status: Some(status), .. }) = event.status else { continue };
            if job.is_none() {
                (self.submitted)(&job_id);
                *job = Some(job_id);
            }
            match status {
                Status::Successful(done) => return Ok(done.partition_location),
                Status::Failed(failed) => {
                    return Err(match own_error(&failed.error) {
                        Some(own) => Failure::Final(EngineError::Remote(own.into())),
                        None => Failure::Passing(failed.error),
                    });
                }
                Status::Queued(_) | Status::Running(_) => {}
            }
        }
        Err(Failure::Passing("the scheduler ended the job without a result".into()))
    }

    /// Fetches results from the executors that have them. A result that one of them has lost does not stop the fetching from others.
    async fn fetch(
        &self,
        locations: Vec<PartitionLocation>,
        units: &[Unit],
        sums: &mut BTreeMap<usize, Vec<u8>>,
    ) -> Result<(), Failure> {
        let mut by_executor: BTreeMap<(String, u16), Vec<PartitionLocation>> = BTreeMap::new();
        for location in locations {
            let Some(executor) = &location.executor_meta else {
                return Err(Failure::Passing("a result without a place".into()));
            };
            by_executor.entry((executor.host.clone(), executor.port as u16)).or_default().push(location);
        }
        let mut lost = None;
        for (address, locations) in by_executor {
            match self.fetch_from(&address, locations, units, sums).await {
                Err(Failure::Passing(reason)) => lost = Some(reason),
                fetched => fetched?,
            }
        }
        lost.map_or(Ok(()), |reason| Err(Failure::Passing(reason)))
    }

    /// Fetches results from one executor.
    async fn fetch_from(
        &self,
        address: &(String, u16),
        locations: Vec<PartitionLocation>,
        units: &[Unit],
        sums: &mut BTreeMap<usize, Vec<u8>>,
    ) -> Result<(), Failure> {
        let lost = |error: BallistaError| passing(&error);
        let mut client = self.executor(address).await.map_err(lost)?;
        for location in locations {
            let layout = location.layout();
            let (Some(executor), Some(partition)) = (location.executor_meta, location.partition_id) else {
                return Err(Failure::Passing("a result without a place".into()));
            };
            let fetched =
                client.fetch_partition(&executor.id, &partition.into(), location.file_id, layout, true).await;
            let mut batches = fetched.map_err(lost)?;
            while let Some(batch) = batches.next().await {
                let batch = batch.map_err(|error| passing(&error))?;
                for (number, sum) in rows::read(&batch)? {
                    if !units.iter().any(|unit| unit.number == number) {
                        let detail = format!("expected a sum of this job, got that of unit {number}");
                        return Err(Failure::Final(EngineError::refused("executor", detail)));
                    }
                    sums.insert(number, sum.to_vec());
                }
            }
        }
        Ok(())
    }

    async fn executor(&self, (host, port): &(String, u16)) -> Result<BallistaClient, BallistaError> {
        let endpoints = Some(Arc::new(BallistaConfigGrpcEndpoint::new(self.network.endpoints())));
        let encrypted = self.network.is_encrypted();
        BallistaClient::try_new(host, *port, MAX_MESSAGE_BYTES, encrypted, endpoints, 2, 100, 0, 0).await
    }
}

/// The plan of a job: a partition for each unit, from the numbers of its parts to its sum.
fn plan(task: &Arc<Task>, division: Division, units: &[Unit]) -> Result<Arc<dyn ExecutionPlan>> {
    let listed = |unit: &Unit| Ok(vec![Parts::batch(unit.parts.clone())?]);
    let listed: Vec<_> = units.iter().map(listed).collect::<Result<_>>()?;
    let listed = MemorySourceConfig::try_new_exec(&listed, Parts::schema(), None)?;
    let sums = Arc::new(SumExec::new(task.clone(), Parts::Listed(listed)));
    if division.size == 1 {
        return Ok(sums);
    }
    Ok(Arc::new(FoldExec::new(task.clone(), sums, division.parts)))
}

fn request(plan: Arc<dyn ExecutionPlan>) -> Result<Request<ExecuteQueryParams>> {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let mut bytes = Vec::new();
    PhysicalPlanNode::try_from_physical_plan(plan, &Codec::default())?.try_encode(&mut bytes)?;
    // A separate session for each job: a scheduler keeps settings by its name.
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let session_id = format!("{}-{number}", std::process::id());
    let mut request = Request::new(ExecuteQueryParams {
        operation_id: session_id.clone(),
        session_id,
        settings: Vec::new(),
        query: Some(Query::PhysicalPlan(bytes)),
    });
    insert_version_header(request.metadata_mut());
    Ok(request)
}

/// A scheduler of another build, a certificate that is not accepted, or bytes that are not a plan, will not do better later.
fn refused(status: &tonic::Status) -> Failure {
    match status.code() {
        Code::FailedPrecondition | Code::InvalidArgument | Code::Unauthenticated | Code::PermissionDenied => {
            Failure::Final(EngineError::refused("--scheduler", status.message()))
        }
        _ => Failure::Passing(status.message().into()),
    }
}

async fn cancel(scheduler: &mut SchedulerGrpcClient<Channel>, job: Option<String>) {
    if let Some(job_id) = job {
        // A scheduler that does not answer has lost the job anyway.
        let _ = scheduler.cancel_job(CancelJobParams { job_id }).await;
    }
}
