{{/* Name of all objects: that of the release, which names the chart at least once. */}}
{{- define "shapelex.name" -}}
{{- $name := ternary .Release.Name (printf "%s-shapelex" .Release.Name) (contains "shapelex" .Release.Name) -}}
{{- $name | trunc 50 | trimSuffix "-" -}}
{{- end }}

{{/* Labels by which the pods of this release are found. */}}
{{- define "shapelex.selector" -}}
app.kubernetes.io/name: shapelex
app.kubernetes.io/instance: {{ .Release.Name }}
{{- end }}

{{- define "shapelex.labels" -}}
{{ include "shapelex.selector" . }}
app.kubernetes.io/part-of: shapelex
app.kubernetes.io/version: {{ .Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .Release.Service }}
helm.sh/chart: {{ printf "%s-%s" .Chart.Name .Chart.Version | replace "+" "_" }}
{{- end }}

{{- define "shapelex.image" -}}
{{- if .Values.image.digest -}}
{{ .Values.image.repository }}@{{ .Values.image.digest }}
{{- else -}}
{{ .Values.image.repository }}:{{ .Values.image.tag | default .Chart.AppVersion }}
{{- end -}}
{{- end }}

{{/* A manifest of deploy/kubernetes with the name, namespace and labels of the release: list of root and name of the file. */}}
{{- define "shapelex.manifest" -}}
{{- $root := index . 0 -}}
{{- $manifest := $root.Files.Get (printf "kubernetes/%s" (index . 1)) | fromYaml -}}
{{- $labels := include "shapelex.labels" $root | fromYaml -}}
{{- $own := dict "name" (include "shapelex.name" $root) "namespace" $root.Release.Namespace "labels" $labels -}}
{{- $_ := set $manifest "metadata" $own -}}
{{- toYaml $manifest -}}
{{- end }}

{{/* Threads for a limit of processors: 2, "1.5" or "1500m". */}}
{{- define "shapelex.threads" -}}
{{- $cpu := toString .Values.resources.limits.cpu -}}
{{- if hasSuffix "m" $cpu -}}
{{ div (add (atoi (trimSuffix "m" $cpu)) 999) 1000 }}
{{- else -}}
{{ ceil $cpu }}
{{- end -}}
{{- end }}

{{/* What a pod of the chart takes from the values: list of root and the pod's spec. */}}
{{- define "shapelex.pod" -}}
{{- $root := index . 0 -}}
{{- $pod := index . 1 -}}
{{- $container := first $pod.containers -}}
{{- $_ := set $container "image" (include "shapelex.image" $root) -}}
{{- $_ = set $container "imagePullPolicy" $root.Values.image.pullPolicy -}}
{{- range $container.env }}
{{- if eq .name "DATABASE_URL" }}
{{- $_ = set .valueFrom.secretKeyRef "name" $root.Values.database.secret }}
{{- $_ = set .valueFrom.secretKeyRef "key" $root.Values.database.key }}
{{- end }}
{{- end }}
{{- range $key := list "imagePullSecrets" "nodeSelector" "tolerations" "affinity" "priorityClassName" }}
{{- with index $root.Values $key }}
{{- $_ = set $pod $key . }}
{{- end }}
{{- end }}
{{- toYaml $pod -}}
{{- end }}
