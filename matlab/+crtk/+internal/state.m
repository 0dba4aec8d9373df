function value = state(device, method, varargin)
%STATE  Call one of the methods that come with the operating state.

    request = struct('do', 'state', 'device', device, 'method', method);
    request.arguments = varargin;
    value = crtk.internal.call(request);
end
