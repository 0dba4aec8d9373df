function varargout = feedback(device, name, varargin)
%FEEDBACK  The newest value of a feedback, in as many outputs as it has parts, then its stamp in s.
%   Options: 'age' and 'wait', in s. With a warning and empty outputs if nothing ever came.

    request = struct('do', 'get', 'device', device, 'name', name);
    for k = 1:2:numel(varargin)
        option = char(varargin{k});
        if ~any(strcmp(option, {'age', 'wait'})) || k == numel(varargin)
            error('crtk:Input', '%s: pass ''age'', seconds or ''wait'', seconds.', name);
        end
        if ~isempty(varargin{k + 1})
            request.(option) = varargin{k + 1};
        end
    end
    answer = crtk.internal.call(request);
    if isfield(answer, 'missing')
        warning('crtk:NoData', '%s has not received messages yet (topic %s)', name, answer.missing);
        varargout = repmat({[]}, 1, max(1, nargout));
        return
    end
    varargout = arrayfun(@crtk.internal.decode, answer.values(:)', 'UniformOutput', false);
end
