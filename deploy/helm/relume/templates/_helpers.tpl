{{/* The name, or name prefix, of all objects of this release. */}}
{{- define "relume.name" -}}
{{- if contains "relume" .Release.Name }}{{ .Release.Name | trunc 50 | trimSuffix "-" }}{{ else }}{{ printf "%s-relume" .Release.Name | trunc 50 | trimSuffix "-" }}{{ end }}
{{- end }}

{{/* Labels that select pods; each use adds the component. */}}
{{- define "relume.selector" -}}
app.kubernetes.io/name: relume
app.kubernetes.io/instance: {{ .Release.Name }}
{{- end }}

{{- define "relume.labels" -}}
{{ include "relume.selector" . }}
app.kubernetes.io/version: {{ .Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .Release.Service }}
helm.sh/chart: {{ .Chart.Name }}-{{ .Chart.Version }}
{{- end }}

{{- define "relume.image" -}}
{{ .Values.image.repository }}:{{ .Values.image.tag | default .Chart.AppVersion }}
{{- end }}

{{/* Security contexts of all containers and pods. The images run as user and group 10001. */}}
{{- define "relume.containerSecurity" -}}
allowPrivilegeEscalation: false
readOnlyRootFilesystem: true
capabilities: {drop: [ALL]}
{{- end }}

{{- define "relume.podSecurity" -}}
runAsNonRoot: true
runAsUser: 10001
runAsGroup: 10001
fsGroup: 10001
fsGroupChangePolicy: OnRootMismatch
seccompProfile: {type: RuntimeDefault}
{{- end }}

{{/* Resources with N GPUs: (dict "resources" ... "gpus" N) */}}
{{- define "relume.resources" -}}
{{- $resources := deepCopy (.resources | default dict) -}}
{{- if .gpus }}{{ $_ := set $resources "limits" (merge (dict "nvidia.com/gpu" (.gpus | toString)) ($resources.limits | default dict)) }}{{ end -}}
{{- toYaml $resources }}
{{- end }}

{{/* The pod of a worker: (dict "root" $ "once" true|false). With `once` the worker does one job and exits. */}}
{{- define "relume.workerPod" -}}
{{- $workers := .root.Values.workers -}}
metadata:
  labels:
    {{- include "relume.selector" .root | nindent 4 }}
    app.kubernetes.io/component: worker
spec:
  {{- with .root.Values.imagePullSecrets }}
  imagePullSecrets: {{- toYaml . | nindent 4 }}
  {{- end }}
  automountServiceAccountToken: false
  enableServiceLinks: false
  terminationGracePeriodSeconds: {{ $workers.terminationGracePeriodSeconds }}
  {{- if .once }}
  restartPolicy: Never
  {{- end }}
  securityContext: {{- include "relume.podSecurity" . | nindent 4 }}
  containers:
    - name: worker
      image: {{ include "relume.image" .root }}
      imagePullPolicy: {{ .root.Values.image.pullPolicy }}
      args: [worker, --cache, /cache{{ if .once }}, --once{{ end }}]
      env:
        - {name: RELUME_SERVER, value: "http://{{ include "relume.name" .root }}:{{ .root.Values.service.port }}"}
        - {name: RELUME_DEVICE, value: {{ $workers.device | quote }}}
        - {name: RELUME_CACHE_BYTES, value: {{ $workers.cacheGiB }}GiB}
        {{- with $workers.labels }}
        - {name: RELUME_WORKER_LABELS, value: {{ join "," . | quote }}}
        {{- end }}
        - name: RELUME_API_KEY
          valueFrom: {secretKeyRef: {name: {{ $workers.secret }}, key: key}}
        {{- with $workers.env }}{{ toYaml . | nindent 8 }}{{ end }}
      resources: {{- include "relume.resources" (dict "resources" $workers.resources "gpus" $workers.gpus) | nindent 8 }}
      securityContext: {{- include "relume.containerSecurity" . | nindent 8 }}
      volumeMounts:
        - {name: cache, mountPath: /cache}
        - {name: tmp, mountPath: /tmp}
  volumes:
    - name: cache
      # Kubernetes evicts a pod that uses more.
      emptyDir: {sizeLimit: {{ add $workers.cacheGiB 10 }}Gi}
    - name: tmp
      emptyDir: {}
  {{- with $workers.nodeSelector }}
  nodeSelector: {{- toYaml . | nindent 4 }}
  {{- end }}
  {{- with $workers.tolerations }}
  tolerations: {{- toYaml . | nindent 4 }}
  {{- end }}
{{- end }}
