# Files that the service reads.
source(file.path("support", "helper.R"))
need_service("files")

file_of <- function(ending, lines) {
  path <- tempfile(fileext = ending)
  writeLines(lines, path)
  path
}

tps <- file_of(".tps", c("LM=3", "10 12.5", "20 12.5", "30 8", "IMAGE=a.jpg", "ID=wing 1", "SCALE=0.5", "LM=3", "1 2", "NA NA", "3 4.25", "ID=wing 2", "SCALE=0.5"))
wings <- read_shapes(tps)
check("TPS: scaled", identical(wings$coords[, , "wing 1"], cbind(c(5, 10, 15), c(6.25, 6.25, 4))), wings$coords)
check("TPS: as in the file", identical(read_shapes(tps, scale = "leave")$coords[1, , 1], c(10, 12.5)))
check("TPS: a missing point", all(is.na(wings$coords[2, , 2])) && !anyNA(wings$coords[-2, , 2]))
check("TPS: missing points are told", any(grepl("Missing points: 1", capture.output(print(wings)))))
check("TPS: and refused by a superimposition", inherits(refusal(gpa(wings)), "shapelex_problem"))

made <- example_shapes(6)
table <- data.frame(id = dimnames(made$coords)[[3]], label = made$species, size = made$size, apply(made$coords, 3, function(x) t(x), simplify = TRUE) |> t())
names(table)[-(1:3)] <- paste0(c("x", "y"), rep(1:10, each = 2))
csv <- tempfile(fileext = ".csv")
write.csv(format(table, digits = 17, trim = TRUE), csv, row.names = FALSE, quote = FALSE)
shapes <- read_shapes(csv)
check("CSV: points", identical(dim(shapes$coords), c(10L, 2L, 6L)) && max(abs(shapes$coords - made$coords)) < 1e-14)
check("CSV: names, labels, attributes", identical(shapes$data$id, table$id) && identical(shapes$data$label, as.character(made$species)) && near(shapes$data$size, made$size, 1e-14))
check("CSV: analysed as it is read", inherits(suppressMessages(lm_shape(shapes ~ label, shapes$data, iter = 19)), "shapelex_lm"))

# The same shapes as other programs write them, by the service.
for (format in c("nts", "morphologika", "npy", "tps")) {
  bytes <- shapelex_request("POST", "/v1/convert", readBin(csv, raw(), 1e6), list(to = format, name = "made.csv"), "application/octet-stream", "*/*")
  other <- tempfile(fileext = paste0(".", format))
  if (is.character(bytes)) bytes <- charToRaw(bytes)
  writeBin(bytes, other)
  back <- read_shapes(other)
  check(paste(format, "holds the same points"), identical(dim(back$coords), c(10L, 2L, 6L)) && max(abs(back$coords - made$coords)) < 1e-12)
}

curves <- file_of(".ndjson", c('{"points":[[0,0],[4,0],[4,1]],"closed":true,"external_id":"a"}', '{"points":[[0,0],[4,0],[4,1],[0,1]],"closed":true}'))
read <- read_shapes(curves)
check("shapes of different numbers of points are a list", is.list(read$coords) && nrow(read$coords[[2]]) == 4 && all(read$closed))
check("which a superimposition refuses", grepl("expected a numeric array", conditionMessage(refusal(gpa(read)))))

broken <- file_of(".tps", c("LM=3", "1 2", "3 x", "4 5", "ID=a"))
problem <- refusal(read_shapes(broken))
check("a broken file has its line", inherits(problem, "shapelex_problem") && grepl("line 3: expected a number", conditionMessage(problem)), conditionMessage(problem))
check("an option that there is none of", inherits(refusal(read_shapes(tps, colour = "red")), "shapelex_problem_invalid_query"))
check("a path that leads nowhere", grepl("expected the path of a file", conditionMessage(refusal(read_shapes("none.tps")))))
done("files")
